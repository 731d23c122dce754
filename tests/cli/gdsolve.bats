#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause

setup() {
	bats_require_minimum_version 1.5.0
	top=$BATS_TEST_DIRNAME/../..
	bin=$(realpath "${GD_BIN:-$top/bin}")
	data=$(realpath "${GD_TESTDATA:-$top/testdata}")
	support=$(realpath "$top/tests/support")
	val=$support/exrval.pl
	size=(16 8)
	cd "$BATS_TEST_TMPDIR"
}

# A ramp and an edge with exact gradients, a noisy colour, and variances; further channels are added.
input() {
	local out=$1 f='$x/8+($y>3?1:0)' args=() c
	shift
	for c in R G B; do
		args+=("$c=$f+0.1*noise()" "dx.$c=\$x==\$w-1?0:1/8" "dy.$c=\$y==3?1:0")
		args+=("dx.variance.$c=1e-4" "dy.variance.$c=1e-4" "truth.$c=$f")
	done
	"$support/mkexr.pl" "$out" "${size[@]}" "${args[@]}" "$@"
}

solve() { "$bin/gdsolve" --compression none "$@"; }
channels() { "$val" "$1" | sed 's/:.*//' | sort; }
near() { awk -v a="$1" -v b="$2" -v t="$3" 'BEGIN { d = a - b; exit !(d <= t && -d <= t) }' || { echo "$1, expected $2"; return 1; }; }

@test "every method finds the ramp and the edge" {
	input in.exr
	for m in ols wls l2 l1; do
		solve -m "$m" in.exr out.exr
		near "$("$val" out.exr R 12 5)" "$(awk -v a="$("$val" out.exr R 4 2)" 'BEGIN { print a + 2 }')" 0.05
	done
	for m in ols wls l2; do
		solve -m "$m" in.exr out.exr
		near "$("$val" out.exr G)" "$("$val" in.exr G)" 1e-4
	done
}

@test "gradients and variances go, everything else passes" {
	input in.exr 'variance.R=1' 'variance.G=1' 'variance.B=1' 'bin0.dx.R=0' 'Z=$x' 'half0.R=1'
	solve in.exr out.exr
	[ "$(channels out.exr | tr '\n' ' ')" = "B G R Z truth.B truth.G truth.R " ]
	[ "$("$val" out.exr Z 7 3)" = 7 ]
	solve --keep in.exr out.exr
	diff <(channels in.exr) <(channels out.exr)
	[ "$("$val" out.exr dx.R 7 3)" = 0.125 ]
}

@test "--layer writes beside the colour" {
	input in.exr
	solve -m wls -l feature in.exr out.exr
	[ "$("$val" out.exr R 5 5)" = "$("$val" in.exr R 5 5)" ]
	[ "$("$val" out.exr | grep -c '^feature\.')" = 3 ]
	[ "$("$val" out.exr | grep -c '^dx\.')" = 6 ]
}

@test "alpha weighs the colour" {
	input in.exr
	solve -m l2 -a 1000 in.exr out.exr
	near "$("$val" out.exr R 9 4)" "$("$val" in.exr R 9 4)" 1e-4
}

# Bins with independent noise: 0.1 in the colour's mean, 0.05 in that of gradients.
binned() {
	local out=$1 f='$x/8+($y>3?1:0)' args=() c b
	shift
	for c in R G B; do
		for b in 0 1; do
			args+=("bin$b.$c=$f+0.2*noise()" "bin$b.dx.$c=(\$x==\$w-1?0:1/8)+0.1*noise()"
				"bin$b.dy.$c=(\$y==3?1:0)+0.1*noise()")
		done
	done
	input "$out" "${args[@]}" "$@"
}

alpha() { sed -E 's/.*"alpha": ([0-9.]+).*/\1/' "$1"; }

@test "--alpha auto: l2 takes the weight that suits the noise, and says so" {
	size=(64 48)
	binned in.exr
	run --separate-stderr solve -v -m l2 --stats s.json in.exr auto.exr
	[ "$status" -eq 0 ]
	a=$(alpha s.json)
	near "$a" 0.5 0.12
	grep -q '"alpha_from": "halves"' s.json
	[[ "$stderr" == *"gdsolve: alpha $a, from the difference of two halves of the samples"* ]]
	[ "$(channels auto.exr | tr '\n' ' ')" = "B G R truth.B truth.G truth.R " ]
	solve -m l2 -a "$a" --stats given.json in.exr given.exr
	[ "$(alpha given.json)" = "$a" ]
	! grep -q alpha_from given.json || false
	for x in 0 7 15; do
		[ "$("$val" auto.exr R $x 5)" = "$("$val" given.exr R $x 5)" ]
	done
}

@test "--alpha auto: variances where there are no bins, 0.2 where nothing tells, and in l1" {
	input in.exr variance.{R,G,B}=4e-4
	solve -m l2 --stats s.json in.exr out.exr
	near "$(alpha s.json)" 0.35 0.002
	grep -q '"alpha_from": "variances"' s.json
	[ "$(channels out.exr | tr '\n' ' ')" = "B G R truth.B truth.G truth.R " ]
	solve -m l1 --stats s.json in.exr out.exr
	[ "$(alpha s.json)" = 0.2 ]
	input plain.exr
	solve -m l2 --stats s.json plain.exr out.exr
	[ "$(alpha s.json)" = 0.2 ]
	grep -q '"alpha_from": "published"' s.json
	solve -m ols --stats s.json plain.exr out.exr
	! grep -q alpha s.json || false
}

@test "--alpha auto leaves bins as they were" {
	binned in.exr
	solve -m l2 --keep in.exr keep.exr
	solve -m l2 -l clean in.exr layer.exr
	for f in keep layer; do
		[ "$("$val" $f.exr | grep bin)" = "$("$val" in.exr | grep bin)" ]
		[ "$("$val" $f.exr bin1.dy.G 5 3)" = "$("$val" in.exr bin1.dy.G 5 3)" ]
	done
}

@test "--alpha: what is neither a weight nor auto is refused" {
	input in.exr
	for a in 0 1e-4 1001 nan 0.2x "" all; do
		run --separate-stderr "$bin/gdsolve" -a "$a" in.exr out.exr
		[ "$status" -eq 2 ]
		[ "$stderr" = "gdsolve: --alpha $a: expected 0.001 to 1000, or auto" ]
		[ ! -e out.exr ]
	done
}

@test "--stats tells what was reached" {
	input in.exr
	solve -m ols --tolerance 1e-5 --stats s.json in.exr out.exr
	grep -q '"residual"' s.json
	grep -q '"iterations"' s.json
	grep -q '"parts": *1' s.json
}

@test "too few iterations: a warning, the file, exit 1" {
	local w=64
	"$support/mkexr.pl" in.exr $w $w R='0' 'dx.R=noise()' 'dy.R=noise()' G=0 'dx.G=noise()' 'dy.G=noise()' B=0 'dx.B=noise()' 'dy.B=noise()'
	run --separate-stderr "$bin/gdsolve" -m ols --iterations 1 --tolerance 1e-5 in.exr out.exr
	[ "$status" -eq 1 ]
	[[ "$stderr" == "gdsolve: warning: in.exr: relative residual "*" after 1 iterations, wanted 1e-05" ]]
	[ -s out.exr ]
}

@test "missing channels are named" {
	"$support/mkexr.pl" a.exr 4 4 R=1 G=1 B=1
	run --separate-stderr "$bin/gdsolve" a.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsolve: a.exr: no channel dx.R" ]
	[ ! -e out.exr ]
	"$support/mkexr.pl" b.exr 4 4 R=1 G=1 B=1 dx.R=0 dx.G=0 dx.B=0 dy.R=0 dy.G=0 dy.B=0
	run --separate-stderr "$bin/gdsolve" -m wls b.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsolve: b.exr: no channel dx.variance.R, which --method wls needs" ]
	"$support/mkexr.pl" c.exr 4 4 dx.R=0 dx.G=0 dx.B=0 dy.R=0 dy.G=0 dy.B=0
	run --separate-stderr "$bin/gdsolve" c.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsolve: c.exr: no channel R, which --method l1 needs" ]
	run --separate-stderr "$bin/gdsolve" -m ols c.exr out.exr
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"the mean of the result is 0" ]]
	run --separate-stderr "$bin/gdsolve" -m l3 b.exr out.exr
	[ "$status" -eq 2 ]
	[[ "$stderr" == *'--method "l3": expected ols, wls, l2 or l1' ]]
}

@test "a pixel that is no number does not spread" {
	input in.exr
	solve -m l1 in.exr sound.exr
	"$support/mkexr.pl" bad.exr 16 8 'R=$x==3&&$y==3?"nan":$x/8' 'G=$x/8' 'B=$x/8' \
		'dx.R=$x==3&&$y==3?"inf":1/8' 'dx.G=1/8' 'dx.B=1/8' dy.R=0 dy.G=0 dy.B=0
	for m in ols l2 l1; do
		solve -m "$m" bad.exr out.exr
		near "$("$val" out.exr R 3 3)" 0.375 0.2
		near "$("$val" out.exr G 12 6)" 1.5 0.2
	done
}

@test "threads do not change a byte" {
	[ -f "$data/kitchen/gpt16.exr" ] || skip "no kitchen"
	export SOURCE_DATE_EPOCH=0
	for m in wls l2 l1; do
		for j in 1 2 7; do
			OMP_NUM_THREADS=$j "$bin/gdsolve" -m "$m" "$data/kitchen/gpt16.exr" - > "out$j.exr"
		done
		cmp out1.exr out2.exr
		cmp out1.exr out7.exr
	done
}

@test "on a real render l1 is better than l2, and l2 than the input" {
	k=$data/kitchen
	[ -f "$k/gpt16.exr" ] || skip "no kitchen"
	"$bin/gdsolve" -m l2 "$k/gpt16.exr" l2.exr
	"$bin/gdsolve" -m l1 "$k/gpt16.exr" l1.exr
	"$bin/gdrelmse" --format tsv -r "$k/reference.exr" "$k/gpt16.exr" l2.exr l1.exr |
		awk -F '\t' '/exr/ && $2 + 0 == $2 { e[++n] = $2 } END { exit !(n == 3 && e[2] < 0.7 * e[1] && e[3] < 0.95 * e[2]) }'
}

# Exact differences to the second pixel right (pair0) and to the lower left one (pair1); colour noise.
paired() {
	local out=$1 f='$x/8+($y>3?1:0)' args=() c
	shift
	for c in R G B; do
		args+=("$c=$f+0.1*noise()" "pair0.$c=2/8" "pair1.$c=(\$y==3?1:0)-1/8")
		args+=("pair0.variance.$c=1" "truth.$c=$f")
	done
	"$support/mkexr.pl" "$out" "${size[@]}" "${args[@]}" 'pair0.x=$x<$w-2?2:0' pair0.y=0 \
		'pair1.x=$x>0&&$y<$h-1?-1:0' 'pair1.y=$x>0&&$y<$h-1?1:0' "$@"
}

@test "--pairs: the differences of any two pixels" {
	paired in.exr
	for m in l2 l1; do
		solve -m "$m" --pairs -a 0.01 in.exr out.exr
		near "$("$val" out.exr R 12 5)" "$(awk -v a="$("$val" out.exr R 4 2)" 'BEGIN { print a + 2 }')" 0.01
		near "$("$val" out.exr G)" "$("$val" in.exr G)" 1e-2
	done
	[ "$(channels out.exr | tr '\n' ' ')" = "B G R truth.B truth.G truth.R " ]
	solve in.exr same.exr
	solve --pairs in.exr out.exr
	[ "$("$val" out.exr R 7 3)" = "$("$val" same.exr R 7 3)" ]
	solve --pairs --keep in.exr out.exr
	diff <(channels in.exr) <(channels out.exr)
	solve --pairs -l clean in.exr out.exr
	[ "$("$val" out.exr R 5 5)" = "$("$val" in.exr R 5 5)" ]
	[ "$("$val" out.exr | grep -c '^clean\.')" = 3 ]
}

@test "--pairs beside dx and dy must be said, and all of them go" {
	paired in.exr dx.R=0 dx.G=0 dx.B=0 dy.R=0 dy.G=0 dy.B=0
	solve -m l2 -a 0.001 in.exr out.exr
	near "$("$val" out.exr R 0 0)" "$("$val" out.exr R 15 7)" 1e-2
	solve --pairs -m l2 -a 0.001 in.exr out.exr
	near "$("$val" out.exr R 15 7)" "$(awk -v a="$("$val" out.exr R 0 0)" 'BEGIN { print a + 15 / 8 + 1 }')" 0.01
	[ "$(channels out.exr | tr '\n' ' ')" = "B G R truth.B truth.G truth.R " ]
}

@test "--pairs: the weight that suits the noise" {
	local args=() c b
	size=(64 48)
	for c in R G B; do
		for b in 0 1; do
			args+=("bin$b.$c=\$x/8+(\$y>3?1:0)+0.2*noise()" "bin$b.pair0.$c=2/8+0.1*noise()"
				"bin$b.pair1.$c=(\$y==3?1:0)-1/8+0.1*noise()")
		done
	done
	paired in.exr "${args[@]}"
	solve --pairs -m l2 --stats s.json in.exr out.exr
	near "$(alpha s.json)" 0.5 0.15
	grep -q '"alpha_from": "halves"' s.json
	[ "$(channels out.exr | tr '\n' ' ')" = "B G R truth.B truth.G truth.R " ]
}

@test "--pairs: what is wrong is said" {
	paired in.exr
	run --separate-stderr "$bin/gdsolve" -m wls in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsolve: --method wls: pairs are solved by l2 or l1" ]
	"$support/mkexr.pl" a.exr 4 4 R=1 G=1 B=1
	run --separate-stderr "$bin/gdsolve" --pairs a.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsolve: a.exr: no channel pair0.x" ]
	"$support/mkexr.pl" b.exr 4 4 R=1 G=1 B=1 pair0.x=0
	run --separate-stderr "$bin/gdsolve" b.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsolve: b.exr: no channel pair0.R" ]
	"$support/mkexr.pl" c.exr 4 4 R=1 G=1 B=1 pair0.x=0 pair0.R=0 pair0.G=0 pair0.B=0
	run --separate-stderr "$bin/gdsolve" c.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsolve: c.exr: no channel pair0.y" ]
	"$support/mkexr.pl" d.exr 4 4 R=1 G=1 pair0.x=0 pair0.y=0 pair0.R=0 pair0.G=0 pair0.B=0
	run --separate-stderr "$bin/gdsolve" d.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsolve: d.exr: no channel B, which pairs need" ]
	"$support/mkexr.pl" e.exr 4 4 R=1 G=1 B=1 pair0.x=3 pair0.y=0 pair0.R=0 pair0.G=0 pair0.B=0
	run --separate-stderr "$bin/gdsolve" e.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsolve: e.exr: pair0.x is 3 at pixel 0,0, expected a whole number from -2 to 2" ]
	[ ! -e out.exr ]
}
