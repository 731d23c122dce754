#!/bin/bash
# SPDX-License-Identifier: BSD-3-Clause
# Does a sampling map pay? A simulation on samples that were really drawn: the eight bins of an input.
#	sampling.sh BIN OBJECTS DATA OUT.tsv [SCENE/INPUT ...]
# Two bins everywhere are denoised; a map of the error spends three more a pixel, six at most, whole bins;
# each pixel gets its bins, and the image is denoised again. Against it: five bins everywhere, as they are
# or as two halves, as the map's are, whichever is better. Columns: what, denoiser, map, relMSE with two
# bins, with five, with the map, and the last over the one before.
set -euo pipefail
bin=$1 obj=$2 data=$3 out=$4
shift 4
PATH=$bin:$obj/support:$PATH
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
export OMP_WAIT_POLICY=passive
inputs=("$@")
if [ ${#inputs[@]} -eq 0 ]; then
	for f in "$data"/*/gpt16.exr "$data"/*/path16eq.exr; do
		[ -f "$f" ] && f=${f#"$data"/} && inputs+=("${f%.exr}")
	done
fi

spend() {	# TO OPTIONS...: the buffer that the denoisers read, with the feature where there are gradients
	local to=$1
	shift
	gdspend "${@:1:$#-2}" "$data/$input.exr" "$tmp/spent.exr" "${@: -2}"
	if perl "$(dirname "$0")/../support/exrval.pl" "$tmp/spent.exr" | grep -q '^dx\.R:'; then
		gdfeature -q "$tmp/spent.exr" -o "$to" --compression none
	else
		mv "$tmp/spent.exr" "$to"
	fi
}

error() { gdrelmse -q --format tsv -r "$data/${input%%/*}/reference.exr" "$1" | tail -n 1 | cut -f2; }

printf 'what\tdenoiser\tmap\ttwo_bins\tfive_bins\twith_map\tratio\n' | tee "$out"
for input in "${inputs[@]}"; do
	spend "$tmp/two.exr" 2 0
	spend "$tmp/five.exr" 2 3
	spend "$tmp/apart.exr" -a 2 3
	for denoiser in ${DENOISERS:-gdapr gdlwr}; do
		[ -x "$bin/$denoiser" ] || continue
		for b in two five apart; do
			"$denoiser" -q "$tmp/$b.exr" -o "$tmp/$b-clean.exr" --compression none
		done
		start=$(error "$tmp/two-clean.exr")
		even=$(printf '%s\n' "$(error "$tmp/five-clean.exr")" "$(error "$tmp/apart-clean.exr")" | sort -g | head -n 1)
		for map in ${MAPS:-own paper}; do
			option=()
			[ "$map" = paper ] && option=(--paper)
			gdsample -q --spp 3 --max 6 --samples 2 "${option[@]}" "$tmp/two-clean.exr" -o "$tmp/map.exr"
			spend "$tmp/more.exr" 2 "$tmp/map.exr"
			"$denoiser" -q "$tmp/more.exr" -o "$tmp/more-clean.exr" --compression none
			printf '%s\t%s\t%s\t%s\t%s\t%s\n' "$input" "$denoiser" "$map" "$start" "$even" "$(error "$tmp/more-clean.exr")"
		done
	done
done | awk -F'\t' -v OFS='\t' '
	{ print $0, sprintf("%.3f", $6 / $5); key = $2 OFS $3; if (!(key in n)) order[++keys] = key
	  n[key]++; log_ratio[key] += log($6 / $5) }
	END { for (k = 1; k <= keys; k++) { key = order[k]
		print "geometric mean", key, "", "", "", sprintf("%.3f", exp(log_ratio[key] / n[key])) } }' | tee -a "$out"
