#!/bin/bash
# SPDX-License-Identifier: BSD-3-Clause
# Error against seconds, a panel for each scene.
#	plot.sh TABLE.tsv OUT.png		columns scene, method (the samples before the first -), relMSE, ., seconds
set -euo pipefail
shopt -s nullglob
table=$1 out=$2
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
mapfile -t scenes < <(awk -F'\t' 'NR > 1 { print $1 }' "$table" | uniq | awk '!seen[$0]++')
n=${#scenes[@]}
# The input costs no time, which has no place on a logarithmic axis: it is drawn as a line across.
awk -F'\t' -v dir="$tmp" 'NR > 1 {
	group = $2; sub(/-.*/, "", group); name = $2; sub(/^[^-]*-/, "", name)
	file = dir "/" $1 "." group
	if (name == "input") print $3 > (file ".input")
	else if ($5 > 0) printf "%s\t%s\t%s\n", $5, $3, name > (file ".points")
}' "$table"
{
	echo "set terminal pngcairo size $((480 * (n > 1 ? 2 : 1) + 40)),$((400 * ((n + 1) / 2))) font 'sans,9'"
	echo "set output '$out'"
	echo "set multiplot layout $(((n + 1) / 2)),$((n > 1 ? 2 : 1))"
	echo "set logscale xy; set grid; set xlabel 'seconds of denoising'; set ylabel 'relMSE'; set key bottom left"
	echo "set offsets graph 0.1, graph 0.25, graph 0.05, graph 0.05"
	for s in "${scenes[@]}"; do
		echo "set title '$s'"
		k=0 plots=()
		for points in "$tmp/$s".*.points; do
			group=${points#"$tmp/$s."}
			group=${group%.points}
			k=$((k + 1))
			plots+=("'$points' using 1:2 with points pt $((k + 4)) lc $k ps 1.2 title '$group'")
			plots+=("'$points' using 1:2:3 with labels left offset 0.8,0.2 font ',7' tc lt $k notitle")
			[ -f "${points%.points}.input" ] &&
				plots+=("$(cat "${points%.points}.input") with lines dt 2 lc $k title '$group input'")
		done
		(IFS=,; echo "plot ${plots[*]}")
	done
} >"$tmp/plot.gp"
gnuplot "$tmp/plot.gp"
