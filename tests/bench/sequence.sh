#!/bin/bash
# SPDX-License-Identifier: BSD-3-Clause
# Sequences made from the scenes' bins, denoised frame by frame and along time: flicker and error.
# Usage: sequence.sh TOOLS HELPERS DATA OUT; KINDS, INPUTS and KEEP=1 (frames stay) in the environment.
# OUT gets sequence.tsv, a row for each sequence and method: "alone" is frame by frame, "along" with
# --previous. What the columns mean: flicker.c; what the sequences are: ../support/mkseq.c.
set -e
bin=$1 obj=$2 data=$3 out=$4
kinds=${KINDS:-static pan object shadow ramp lamp sudden}
inputs=${INPUTS:-plain}
mkdir -p "$out/sequence"

denoise() {	# INPUT FRAME OUTPUT [OPTION ...]
	local input=$1 frame=$2 result=$3
	shift 3
	if [ "$input" = gpt16 ]; then
		"$bin/gdfeature" -q "$frame" | "$bin/gdlwr" -q "$@" - -o "$result"
	else
		"$bin/gdlwr" -q "$@" "$frame" -o "$result"
	fi
}

one() {		# SCENE KIND INPUT OTHER-SCENE
	local d=$out/sequence/$1-$2-$3 before
	"$obj/support/mkseq" "$data/$1" "$d" "$2" input="$3" object="$data/$4"
	for frame in "$d"/frame*.exr; do
		t=${frame#"$d"/frame}
		t=${t%.exr}
		denoise "$3" "$frame" "$d/alone$t.exr"
		if [ "$t" = 0 ]; then
			denoise "$3" "$frame" "$d/along$t.exr" --state
		else
			denoise "$3" "$frame" "$d/along$t.exr" --previous "$before"
		fi
		before=$d/along$t.exr
	done
	"$obj/bench/flicker" "$d" alone along
	if [ -z "$KEEP" ]; then rm -r "$d"; fi
}

scenes=()
for s in "$data"/*/reference.exr; do
	s=$(dirname "$s")
	if [ -f "$s/gpt16.exr" ] && [ -f "$s/path16eq.exr" ]; then scenes+=("$(basename "$s")"); fi
done
if [ ${#scenes[@]} = 0 ]; then echo "no scene with gpt16.exr and path16eq.exr in $data: no sequences"; exit; fi

printf 'sequence\tmethod\tflicker\tlate\trelmse\tlast\tedge\tobject\n' >"$out/sequence.tsv"
for input in $inputs; do
	for ((i = 0; i < ${#scenes[@]}; i++)); do
		for kind in $kinds; do
			one "${scenes[i]}" "$kind" "$input" "${scenes[(i + 1) % ${#scenes[@]}]}"
		done
	done
done | tee -a "$out/sequence.tsv"

# Geometric means over the scenes, and how many times less it is along time.
awk -F'\t' 'NR == 1 { for (i = 3; i <= NF; i++) head[i] = $i; next }
	{ split($1, part, "-"); k = part[2] "-" part[3]
	  if (!(k in seen)) { seen[k] = 1; kind[++n] = k }
	  for (i = 3; i <= NF; i++) if ($i + 0 > 0) { sum[k, $2, i] += log($i); count[k, $2, i]++ } }
	END { printf "%-16s", "sequence"; for (i = 3; i <= 8; i++) printf " %28s", head[i]; print ""
	  for (j = 1; j <= n; j++) { k = kind[j]; printf "%-16s", k
	    for (i = 3; i <= 8; i++) if (count[k, "alone", i]) {
	      a = exp(sum[k, "alone", i] / count[k, "alone", i])
	      b = exp(sum[k, "along", i] / count[k, "along", i])
	      printf " %9.5f -> %8.5f %5.2fx", a, b, a / b } else printf " %28s", "-"
	    print "" } }' "$out/sequence.tsv" >"$out/sequence.txt"
cat "$out/sequence.txt"
if [ -z "$KEEP" ]; then rmdir "$out/sequence"; fi
