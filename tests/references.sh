#!/bin/bash
# SPDX-License-Identifier: BSD-3-Clause
# References of the scenes: tests/references.sh BIN SCENES OUT [NAME ...]
# Renders SCENES/NAME.gltf (all of them if none is named) in REF_PASSES parts of REF_SPP samples a pixel,
# OUT/NAME.partK.exr, by path tracing alone, and merges them into OUT/NAME.exr with two independent halves.
# Parts that exist are kept, so that it goes on where it was stopped; more passes add parts. Parts of
# another size, other options or another scene are rendered again.
set -eu
bin=$1 scenes=$2 out=$3
shift 3
size=${REF_SIZE:-256x192} passes=${REF_PASSES:-8} spp=${REF_SPP:-1024}
[ "$passes" -ge 2 ] || { echo "references.sh: REF_PASSES is $passes, halves need at least 2" >&2; exit 2; }
mkdir -p "$out"
if [ $# -eq 0 ]; then
	for f in "$scenes"/*.gltf; do
		set -- "$@" "$(basename "$f" .gltf)"
	done
fi

one() {	# NAME
	local name=$1 args files how parts=() part k
	read -r -a args <"$scenes/$name.args" || true
	mapfile -t files < <(grep -o '"uri": "[^"]*"' "$scenes/$name.gltf" | cut -d'"' -f4)
	# What the parts depend on.
	how="$size $spp ${args[*]} $(cd "$scenes" && cat -- "$name.gltf" "${files[@]}" | cksum)"
	if [ "$(cat "$out/$name.how" 2>/dev/null || true)" != "$how" ]; then
		rm -f "$out/$name".part*.exr "$out/$name.exr"
		echo "$how" >"$out/$name.how"
	fi
	for ((k = 0; k < passes; k++)); do
		part=$out/$name.part$k.exr
		parts+=("$part")
		[ -f "$part" ] && continue
		echo "$name: part $((k + 1)) of $passes, $spp samples a pixel"
		(cd "$scenes" && "$bin/gdrender" "${args[@]}" --gradients 0 --bins 0 --size "$size" --spp "$spp" \
			--seed $((1000 + k)) "$name.gltf" "$part")
		rm -f "$out/$name.exr"
	done
	[ -f "$out/$name.exr" ] || "$bin/gdmerge" -q --halves -o "$out/$name.exr" "${parts[@]}"
}

bin=$(realpath "$bin") scenes=$(realpath "$scenes") out=$(realpath "$out")
for name; do
	[ -f "$scenes/$name.gltf" ] || { echo "references.sh: no scene $name in $scenes" >&2; exit 2; }
	one "$name"
done
