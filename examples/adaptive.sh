#!/bin/bash
# SPDX-License-Identifier: BSD-3-Clause
# Renders a scene in passes, each where the one before says that samples help, and denoises it.
#	adaptive.sh [options] scene.gltf clean.exr [-- options of gdrender]
# Passes cost as much as so many plain samples a pixel; one that traces gradients counts as two. The first pass
# is even. Then, until all passes are done:
#	gdmerge pass*.exr | gdfeature | gdapr		what all samples say so far, and its error
#	gdsample					where the next ones go
#	gdrender --sampling --gradients			the next pass, of another seed
# With -g auto gdsample --gradients says which samples of the next passes should trace gradients; where they
# turn out to gain less than 5 %, later passes do without them, and so does the result.
set -euo pipefail
export OMP_WAIT_POLICY=${OMP_WAIT_POLICY:-passive}

usage() {
	cat <<'END'
usage: adaptive.sh [options] scene.gltf clean.exr [-- options of gdrender]
  -n SPP      what each pass costs, in plain samples a pixel (32)
  -p PASSES   passes in all, 1 to 99 (3)
  -g WHAT     gradients: with all samples (all), none, this share of them, or where a trial says (auto)
  -u          uniform: every pass is even
  -f SPP      the same of the first pass (a third); 4 samples at least where -g is auto
  -d TOOL     denoiser of the result: gdapr or gdlwr (gdapr)
  -b BINS     bins of a pass, 4 to 64 (8)
  -c COST     of a sample with gradients, in plain ones (2)
  -s SEED     of the first pass; each pass adds one (1)
  -k DIR      keep passes, maps and figures in DIR, and take passes that are there already
  -q          no progress
  -h          this text
END
}

fail() { echo "adaptive.sh: $*" >&2; exit 2; }

spp=32 passes=3 gradients=all uniform="" first="" denoiser=gdapr bins=8 cost=2 seed=1 keep="" quiet=""
while getopts n:p:g:uf:d:b:c:s:k:qh o; do
	case $o in
	n) spp=$OPTARG ;;
	p) passes=$OPTARG ;;
	g) gradients=$OPTARG ;;
	u) uniform=yes ;;
	f) first=$OPTARG ;;
	d) denoiser=$OPTARG ;;
	b) bins=$OPTARG ;;
	c) cost=$OPTARG ;;
	s) seed=$OPTARG ;;
	k) keep=$OPTARG ;;
	q) quiet=-q ;;
	h) usage; exit 0 ;;
	*) usage >&2; exit 2 ;;
	esac
done
shift $((OPTIND - 1))
[ $# -ge 2 ] || { usage >&2; exit 2; }
scene=$1 out=$2
shift 2
[ "${1:-}" = -- ] && shift
more=("$@")
[[ $passes =~ ^[1-9][0-9]?$ ]] || fail "-p $passes: expected 1 to 99"
[[ $spp =~ ^[0-9]+([.][0-9]+)?$ && ${first:-1} =~ ^[0-9]+([.][0-9]+)?$ ]] || fail "-n $spp -f $first: expected numbers"
case $gradients in
auto | all) share=1 ;;
none) share=0 ;;
*) share=$gradients ;;
esac
[[ $share =~ ^(0|1|0?[.][0-9]+|1[.]0+|0[.])$ ]] || fail "-g $gradients: expected a share from 0 to 1, all, none or auto"
[[ $cost =~ ^[1-9][0-9]*([.][0-9]+)?$ ]] || fail "-c $cost: expected a number from 1"
if awk -v s="$share" 'BEGIN { exit s > 0 }'; then gradients=none; fi
[[ $denoiser =~ ^(gdapr|gdlwr)$ ]] || fail "-d $denoiser: expected gdapr or gdlwr"
for tool in gdrender gdmerge gdfeature gdapr gdsample "$denoiser"; do
	command -v "$tool" >/dev/null || fail "$tool: not found; is it built, and its directory in PATH?"
done
[ -r "$scene" ] || fail "$scene: cannot be read"

dir=$keep
if [ -n "$keep" ]; then
	mkdir -p "$keep"
else
	dir=$(mktemp -d)
	trap 'rm -rf "$dir"' EXIT
fi

tell() { [ -n "$quiet" ] || echo "$*" >&2; }

# A stage between two others: EXR through memory or a fast disk, not packed.
between=(--compression none)

# What is known from all passes so far, denoised by a tool.
denoise() {	# TOOL OUT OPTIONS...
	local tool=$1 to=$2
	shift 2
	if [ "$gradients" = none ]; then
		"$tool" -q "$dir/all.exr" -o "$to" "$@"
	else
		gdfeature -q "$dir/all.exr" "${between[@]}" | "$tool" -q - -o "$to" "$@"
	fi
}

# A figure of a --stats file.
figure() { sed -E "s/.*\"$2\": ([^,}]*).*/\\1/" "$1"; }

# So many samples, plain ones, with the share that traces gradients.
fewer() { awk -v n="$1" -v c="$cost" -v s="$share" 'BEGIN { print n / (1 + s * (c - 1)) }'; }

# So many samples a pixel.
even() {
	local n least=1
	# what gradients gain is told by four bins
	if [ "$gradients" = auto ] && ((passes > 1)); then least=4; fi
	n=$(awk -v n="$(fewer "$1")" -v m=$least 'BEGIN { n = int(n + 0.5); print (n > m ? n : m) }')
	render=(--spp "$n" --gradients "$share")
}

# The next pass: how many samples where, and which of them trace gradients.
plan() {
	local map=(--spp "$spp" --multiple 2) gain
	if [ "$gradients" = auto ]; then
		map+=(--gradients "$dir/all.exr" --gradient-cost "$cost")
	else
		map[1]=$(fewer "$spp")
	fi
	[ -n "$uniform" ] && map+=(--floor 1)
	denoise gdapr "$dir/clean.exr" "${between[@]}"
	gdsample -q "${map[@]}" --stats "$dir/plan$i.json" "$dir/clean.exr" -o "$dir/map$i.exr"
	render=(--sampling "$dir/map$i.exr" --gradients "$share")
	if [ "$gradients" = auto ]; then
		render[3]=$dir/map$i.exr
		gain=$(figure "$dir/plan$i.json" gradients_gain)
		tell "$(awk -v s="$(figure "$dir/plan$i.json" gradients)" -v g="$gain" 'BEGIN { printf "gradients for " \
			"%.0f %% of the pixels: %.2f times the error of plain samples in the same time", 100 * s, g }')"
		if awk -v g="$gain" 'BEGIN { exit !(g > 0.95) }'; then
			tell "gradients do not pay here: none from now on"
			gradients=none share=0 render[3]=0
		fi
	fi
}

# Colours from the neighbours' offset paths, too: after denoising, lower errors on every scene tried.
reuse=(--reuse-offsets)
for word in "${more[@]}"; do [[ $word == --ambient* ]] && reuse=(); done

for ((i = 1; i <= passes; i++)); do
	pass=$dir/pass$i.exr
	if ((i == 1)); then
		even "${first:-$(awk -v n="$spp" 'BEGIN { print n / 3 }')}"
	elif [ -n "$uniform" ] && [ "$gradients" != auto ]; then
		even "$spp"
	else
		plan
	fi
	if [ -z "$keep" ] || [ ! -f "$pass" ]; then
		tell "pass $i of $passes"
		# what is wrong with the scene is told once
		told=-q
		if ((i == 1)); then told=$quiet; fi
		gdrender ${told:+"$told"} "${between[@]}" --stats "${pass%.exr}.json" --bins "$bins" --seed $((seed + i - 1)) "${render[@]}" "${reuse[@]}" "${more[@]}" "$scene" "$pass"
	fi
	inputs=()
	for ((k = 1; k <= i; k++)); do inputs+=("$dir/pass$k.exr"); done
	gdmerge -q "${inputs[@]}" -o "$dir/all.exr" "${between[@]}"
done
denoise "$denoiser" "$out"
