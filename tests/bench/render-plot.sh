#!/bin/bash
# SPDX-License-Identifier: BSD-3-Clause
# Error against seconds, a panel for each scene, a line for each method.
#	render-plot.sh TABLE.tsv OUT.png	columns scene, method, spp, seconds, relMSE, with a head
set -euo pipefail
table=$1 out=$2
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
mapfile -t scenes < <(awk -F'\t' 'NR > 1 && !seen[$1]++ { print $1 }' "$table")
mapfile -t methods < <(awk -F'\t' 'NR > 1 && !seen[$2]++ { print $2 }' "$table")
awk -F'\t' -v dir="$tmp" 'NR > 1 && $5 > 0 { print $4 "\t" $5 > (dir "/" $1 "." $2) }' "$table"
n=${#scenes[@]} columns=$((n > 1 ? 2 : 1))
{
	echo "set terminal pngcairo size $((560 * columns + 40)),$((420 * ((n + columns - 1) / columns))) font 'sans,9'"
	echo "set output '$out'"
	echo "set multiplot layout $(((n + columns - 1) / columns)),$columns"
	echo "set logscale xy; set grid; set xlabel 'seconds, rendering included'; set ylabel 'relMSE'"
	echo "set key outside right"
	for s in "${scenes[@]}"; do
		echo "set title '$s'"
		plots=()
		for k in "${!methods[@]}"; do
			f=$tmp/$s.${methods[k]}
			[ -f "$f" ] && plots+=("'$f' using 1:2 with linespoints lt $((k + 1)) pt $((k % 12 + 4)) title '${methods[k]}'")
		done
		(IFS=,; echo "plot ${plots[*]}")
	done
} >"$tmp/plot.gp"
gnuplot "$tmp/plot.gp"
