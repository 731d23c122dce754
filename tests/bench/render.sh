#!/bin/bash
# SPDX-License-Identifier: BSD-3-Clause
# relMSE against seconds, rendering included, of every way to spend them.
#	render.sh BIN SCENES REFERENCES OUT [NAME ...]
# A budget is so many plain samples a pixel; a sample that traces gradients counts as 2. With each budget
# every method renders SCENES/NAME.gltf by itself, where what it renders is not what another renders, too:
#	path		plain samples, as they are; path-apr, path-lwr: denoised with G-buffers
#	gpt-l2, gpt-l1	gradients with every sample, solved; gpt-apr, gpt-lwr: gdfeature, then denoised
#	mixed-apr, -lwr	the same with gradients for half of the samples
#	pairs-l2 ...	gradients between pixels that look alike in a render of 4 plain samples, solved
#	...-adaptive	three passes of examples/adaptive.sh, the first small: plain ones, with gradients for
#			every sample (gpt) or for half of them (mixed)
# Wherever gradients are traced, the colour reuses the offset paths.
# OUT/NAME.BUDGET/ holds the images; passes and maps of METHOD are in METHOD.exr.passes.
# REFERENCES/NAME.exr is what they are measured against. What is in OUT already is not rendered again.
# Variables: RENDER_SPP (budgets), RENDER_COST, RENDER_SHARE, RENDER_METHODS, RENDER_TIME (wall, or cpu: user and system
# seconds, for machines that do other things, too)
set -euo pipefail
bin=$(realpath "$1") scenes=$(realpath "$2") references=$(realpath "$3") out=$4
shift 4
here=$(realpath "$(dirname "$0")")
PATH=$bin:$here/../../examples:$PATH
export OMP_WAIT_POLICY=passive
unset SOURCE_DATE_EPOCH
budgets=${RENDER_SPP:-16 64} cost=${RENDER_COST:-2} share=${RENDER_SHARE:-0.5} clock=${RENDER_TIME:-wall}
methods=${RENDER_METHODS:-path path-apr path-lwr gpt-l2 gpt-l1 gpt-apr gpt-lwr pairs-l2 pairs-l1 mixed-apr mixed-lwr \
path-adaptive gpt-adaptive mixed-adaptive}
plain=(--compression none)
[[ $clock = wall || $clock = cpu ]] || { echo "render.sh: RENDER_TIME=$clock: expected wall or cpu" >&2; exit 2; }
mkdir -p "$out"
out=$(realpath "$out")
if [ $# -eq 0 ]; then
	for f in "$references"/*.exr; do
		name=$(basename "$f" .exr)
		[[ $name = *.* ]] || [ ! -f "$scenes/$name.gltf" ] || set -- "$@" "$name"
	done
fi
[ $# -gt 0 ] || { echo "render.sh: no references in $references (make references)" >&2; exit 2; }

# Runs a command that makes FILE.exr, unless that is there, and notes the seconds it took beside it.
made() {	# FILE COMMAND...
	local file=$1 TIMEFORMAT='%R %U %S'
	shift
	[ -f "$file.exr" ] && [ -f "$file.time" ] && return
	{ time "$@" "$file.exr" >"$file.log" 2>&1; } 2>"$file.clock" || { cat "$file.log" >&2; return 2; }
	awk -v clock="$clock" '{ print clock == "wall" ? $1 : $2 + $3 }' "$file.clock" >"$file.time"
	rm -f "$file.log" "$file.clock"
}

# The rendering of a scene: options first, the output last.
render() { gdrender -q "${plain[@]}" "${args[@]}" --size "$size" "${@:1:$#-1}" "$scenes/$name.gltf" "${@: -1}"; }
adaptive() {
	rm -rf "${*: -1}.passes"
	adaptive.sh -q -c "$cost" -k "${*: -1}.passes" -f "$first" -n "$(awk -v n="$n" -v f="$first" 'BEGIN { print (n - f) / 2 }')" \
		-b "$bins" \
		"${@:1:$#-1}" "$scenes/$name.gltf" "${@: -1}" -- "${args[@]}" --size "$size"
}
feature() { gdfeature -q "${plain[@]}" "$@"; }

# Samples of the budget, with that share tracing gradients.
fewer() { awk -v n="$n" -v c="$cost" -v s="$1" 'BEGIN { n = int(n / (1 + s * (c - 1)) + 0.5); print (n > 1 ? n : 1) }'; }

# Makes dir/METHOD.exr; its stages, whose seconds add up, go to $stages.
method() {	# METHOD
	local m=$1 feature
	stages=()
	case $m in
	*-adaptive) ;;
	path*) stages=(path); made "$dir/path" render --spp "$n" --gradients 0 ;;
	gpt*) stages=(gpt); made "$dir/gpt" render --spp "$(fewer 1)" --bins "$bins" --reuse-offsets ;;
	mixed*)
		stages=(mixed)
		made "$dir/mixed" render --spp "$(fewer "$share")" --gradients "$share" --bins "$bins" --reuse-offsets
		;;
	pairs*)
		stages=(guide pairs)
		made "$dir/guide" render --spp 4 --gradients 0 --bins 0 --seed 77
		made "$dir/pairs" render --spp "$(fewer 1)" --bins "$bins" --reuse-offsets --pairs "$dir/guide.exr"
		;;
	esac
	case $m in
	gpt-apr | gpt-lwr | mixed-apr | mixed-lwr)
		feature=${m%-*}-feature
		stages+=("$feature")
		made "$dir/$feature" feature "$dir/${m%-*}.exr" -o
		;;
	esac
	[ "$m" = path ] || stages+=("$m")
	case $m in
	path) ;;
	path-apr) made "$dir/$m" gdapr -q "$dir/path.exr" -o ;;
	path-lwr) made "$dir/$m" gdlwr -q "$dir/path.exr" -o ;;
	gpt-l[12]) made "$dir/$m" gdsolve -q -m "${m#gpt-}" "$dir/gpt.exr" -o ;;
	gpt-apr | mixed-apr) made "$dir/$m" gdapr -q "$dir/$feature.exr" -o ;;
	gpt-lwr | mixed-lwr) made "$dir/$m" gdlwr -q "$dir/$feature.exr" -o ;;
	pairs-l[12]) made "$dir/$m" gdsolve -q --pairs -m "${m#pairs-}" "$dir/pairs.exr" -o ;;
	path-adaptive) made "$dir/$m" adaptive -g none ;;
	gpt-adaptive) made "$dir/$m" adaptive -g all ;;
	mixed-adaptive) made "$dir/$m" adaptive -g "$share" ;;
	*) echo "render.sh: no method $m" >&2; return 2 ;;
	esac
}

row() {	# METHOD
	local s error
	s=$(for t in "${stages[@]}"; do cat "$dir/$t.time"; done | awk '{ s += $1 } END { print s }')
	error=$(gdrelmse -q --format tsv -r "$references/$name.exr" "$dir/$1.exr" | tail -n 1 | cut -f2)
	printf '%s\t%s\t%s\t%s\t%s\n' "$name" "$1" "$n" "$s" "$error"
}

printf 'scene\tmethod\tspp\tseconds\trelMSE\n' >"$out/render.tsv"
for name; do
	[ -f "$references/$name.exr" ] || { echo "render.sh: no reference $references/$name.exr" >&2; exit 2; }
	read -r -a args <"$scenes/$name.args" || true
	size=$(gdrelmse -v -r "$references/$name.exr" "$references/$name.exr" 2>&1 |
		sed -En 's/.*: ([0-9]+) x ([0-9]+) pixels.*/\1x\2/p' | head -n 1)
	for n in $budgets; do
		dir=$out/$name.$n
		mkdir -p "$dir"
		first=$((n < 20 ? n / 2 : n < 80 ? 10 : n / 8)) bins=$((first >= 20 ? 8 : 4))
		for m in $methods; do
			method "$m" || continue
			row "$m" | tee -a "$out/render.tsv"
		done
	done
done
"$here/equal.awk" "$out/render.tsv" >"$out/render.txt"
cat "$out/render.txt"
if command -v gnuplot >/dev/null; then
	"$here/render-plot.sh" "$out/render.tsv" "$out/render.png"
else
	echo "no plot: gnuplot is not installed"
fi
