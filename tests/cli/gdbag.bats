#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause

setup() {
	bats_require_minimum_version 1.5.0
	top=$BATS_TEST_DIRNAME/../..
	bin=$(realpath "${GD_BIN:-$top/bin}")
	data=$(realpath "${GD_TESTDATA:-$top/testdata}")
	support=$(realpath "$top/tests/support")
	val=$support/exrval.pl
	cd "$BATS_TEST_TMPDIR"
}

# A ramp, as $2 bins of noisy gradients; further channels are added.
input() {
	local out=$1 bins=$2 args=() b c
	shift 2
	for c in R G B; do
		for ((b = 0; b < bins; b++)); do
			args+=("bin$b.dx.$c=\$x==\$w-1?0:1/8+0.05*noise()" "bin$b.dy.$c=\$y==\$h-1?0:0.05*noise()")
		done
		args+=("$c=\$x/8" "dx.$c=1/8" "dy.$c=0")
	done
	"$support/mkexr.pl" "$out" 24 16 "${args[@]}" "$@"
}

bag() { "$bin/gdbag" --compression none "$@"; }
near() { awk -v a="$1" -v b="$2" -v t="$3" 'BEGIN { d = a - b; exit !(d <= t && -d <= t) }' || { echo "$1, expected $2"; return 1; }; }
above() { awk -v a="$1" -v b="$2" 'BEGIN { exit !(a > b) }' || { echo "$1, expected more than $2"; return 1; }; }

@test "a feature with the mean of the colour, and its variance" {
	input in.exr 8 'Z=$x'
	bag in.exr out.exr
	near "$("$val" out.exr feature.G)" "$("$val" in.exr G)" 1e-4
	near "$("$val" out.exr feature.R 20 8)" 2.5 0.15
	above "$("$val" out.exr feature.variance.B)" 1e-6
	[ "$("$val" out.exr R 9 4)" = "$("$val" in.exr R 9 4)" ]
	[ "$("$val" out.exr Z 9 4)" = 9 ]
	[ "$("$val" out.exr | grep -c '^bin')" = 0 ]
	[ "$("$val" out.exr | grep -c '^dx\.')" = 3 ]
}

@test "--keep keeps the bins, --layer names the result" {
	input in.exr 4
	bag --keep -l guide in.exr out.exr
	[ "$("$val" out.exr | grep -c '^bin')" = 24 ]
	[ "$("$val" out.exr bin2.dy.G 5 5)" = "$("$val" in.exr bin2.dy.G 5 5)" ]
	above "$("$val" out.exr guide.variance.R)" 0
}

@test "the local variance is below the full one" {
	input in.exr 8
	bag in.exr full.exr
	bag --local in.exr local.exr
	above "$("$val" full.exr feature.variance.R)" "$("$val" local.exr feature.variance.R)"
	above "$("$val" local.exr feature.variance.R)" 0
	bag --local --local-sigma 0.5 in.exr less.exr
	above "$("$val" local.exr feature.variance.R)" "$("$val" less.exr feature.variance.R)"
}

@test "the seed decides, threads do not" {
	input in.exr 8
	export SOURCE_DATE_EPOCH=0
	for j in 1 2 7; do OMP_NUM_THREADS=$j "$bin/gdbag" in.exr - > "out$j.exr"; done
	cmp out1.exr out2.exr
	cmp out1.exr out7.exr
	bag -s 2 in.exr two.exr
	bag -s 3 -B 20 in.exr three.exr
	[ "$("$val" two.exr feature.R 7 7)" != "$("$val" three.exr feature.R 7 7)" ]
}

@test "without bins: a warning, and a feature all the same" {
	input in.exr 1
	run --separate-stderr "$bin/gdbag" --compression none in.exr out.exr
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"no bins of gradients"* ]]
	near "$("$val" out.exr feature.R 20 8)" 2.5 0.01
}

@test "missing channels are named" {
	"$support/mkexr.pl" a.exr 4 4 R=1 G=1 B=1
	run --separate-stderr "$bin/gdbag" a.exr out.exr
	[ "$status" -eq 2 ]
	[[ "$stderr" == *"a.exr: no channel dx.R" ]]
	[ ! -e out.exr ]
	"$support/mkexr.pl" b.exr 4 4 bin0.dx.R=0 bin0.dx.G=0 bin0.dx.B=0 bin1.dx.R=0 bin1.dx.G=0 bin1.dx.B=0 \
		bin0.dy.R=0 bin0.dy.G=0 bin0.dy.B=0
	run --separate-stderr "$bin/gdbag" b.exr out.exr
	[ "$status" -eq 2 ]
	[[ "$stderr" == *"2 bins of dx, but 1 of dy" ]]
}

@test "--stats" {
	input in.exr 3
	bag --stats s.json --tolerance 0.001 --floor 1 --smooth 0 in.exr out.exr
	grep -q '"bins": *3' s.json
	grep -q '"replicates": *10' s.json
}
