#!/bin/bash
# SPDX-License-Identifier: BSD-3-Clause
# Speed, growth with size, memory and start-up of the tools, on real noise tiled to any size.
#	speed.sh BIN OBJECTS INPUT.exr OUT.tsv [WIDTHxHEIGHT ...]
# Columns: what, megapixels, seconds without reading and writing (median of $RUNS, 3), wall seconds, CPU
# seconds, peak memory in MB, and bytes a pixel beyond what a tool takes that does nothing.
set -euo pipefail
bin=$1 obj=$2 input=$3 out=$4
shift 4
sizes=("${@:-1280x720}")
runs=${RUNS:-3}
PATH=$bin:$obj/support:$obj/bench:$PATH
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
export OMP_WAIT_POLICY=passive

net() {	# seconds without reading and writing, from --stats
	sed -E 's/.*"seconds": ([0-9.e+-]+).*"io_seconds": ([0-9.e+-]+).*/\1 \2/' "$tmp/stats" | awk '{ print $1 - $2 }'
}

timed() {	# LABEL MEGAPIXELS TOOL ARGUMENTS: the line of a tool on a file
	local label=$1 mega=$2 i
	shift 2
	for ((i = 0; i < runs; i++)); do
		measure "$label" 1 "$@" -q --stats "$tmp/stats" -o /dev/null >>"$tmp/lines"
		net >>"$tmp/net"
	done
	awk -v net="$(sort -g "$tmp/net" | sed -n "$(((runs + 1) / 2))p")" -v mega="$mega" -F'\t' '
		{ w[NR] = $2; c[NR] = $3; if ($4 > peak) peak = $4 }
		END { sort(w); sort(c); k = int((NR + 1) / 2)
			printf "%s\t%.3f\t%.3f\t%.3f\t%.3f\t%.0f\t%.0f\n", $1, mega, net, w[k], c[k], peak,
				(peak - 3) * 1.048576 / mega }
		function sort(a,   i, j, t) { for (i = 2; i <= NR; i++) { t = a[i]
			for (j = i - 1; j > 0 && a[j] > t; j--) a[j + 1] = a[j]; a[j + 1] = t } }' "$tmp/lines" | tee -a "$out"
	rm -f "$tmp/net" "$tmp/lines"
}

printf 'what\tmegapixels\tseconds\twall\tcpu\tpeak_mb\tbytes_a_pixel\n' | tee "$out"
for size in "${sizes[@]}"; do
	w=${size%x*} h=${size#*x}
	mega=$(awk "BEGIN { print $w * $h / 1e6 }")
	gdcut "$input" "$tmp/in.exr" 0 0 "$w" "$h" bin
	mv "$tmp/in.exr" "$tmp/solve.exr"
	for m in l2 wls l1; do timed "gdsolve $m" "$mega" gdsolve -a 0.2 -m $m "$tmp/solve.exr"; done
	rm "$tmp/solve.exr"
	gdcut "$input" "$tmp/in.exr" 0 0 "$w" "$h"
	timed gdbag "$mega" gdbag "$tmp/in.exr"
	timed gdfeature "$mega" gdfeature "$tmp/in.exr"
	gdfeature -q "$tmp/in.exr" -o "$tmp/feature.exr" --compression none
	rm "$tmp/in.exr"
	timed gdapr "$mega" gdapr "$tmp/feature.exr"
	timed "gdapr --fast" "$mega" gdapr --fast "$tmp/feature.exr"
	timed "gdapr --paper" "$mega" gdapr --paper "$tmp/feature.exr"
	timed gdlwr "$mega" gdlwr "$tmp/feature.exr"
	timed "gdlwr --dense" "$mega" gdlwr --dense "$tmp/feature.exr"
	gdlwr -q "$tmp/feature.exr" -o "$tmp/clean.exr" --compression none
	timed gdsample "$mega" gdsample --spp 8 "$tmp/clean.exr"
	rm "$tmp/feature.exr" "$tmp/clean.exr" "$tmp/stats"
done
{
	echo
	mkgd "$tmp/in.exr" 1280 720
	measure "reading $(perl "$(dirname "$0")/../support/exrval.pl" "$tmp/in.exr" | wc -l) float channels of 1280x720 from a pipe (wall, CPU s, MB)" 3 \
		bash -c "cat '$tmp/in.exr' | gdcheck -c '^R\$' -"
	for t in "$bin"/gd*; do
		[[ $t == *.so ]] || measure "starting ${t##*/} (wall, CPU s, MB)" 20 "$t" --version
	done
} | tee -a "$out"
