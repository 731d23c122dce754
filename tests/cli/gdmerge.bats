#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause

setup() {
	bats_require_minimum_version 1.5.0
	top=$BATS_TEST_DIRNAME/../..
	bin=$(realpath "${GD_BIN:-$top/bin}")
	gdmerge=$bin/gdmerge
	support=$(realpath "$top/tests/support")
	cd "$BATS_TEST_TMPDIR"
}

make_exr() { "$support/mkexr.pl" "$@"; }
val() { "$support/exrval.pl" "$@"; }
names() { "$support/exrval.pl" "$1" | sed 's/:.*//' | sort; }

# Five runs of 2 samples whose values are 1 .. 5.
five() {
	for i in 1 2 3 4 5; do
		make_exr "run$i.exr" 4 3 -a gd:samplesPerPixel=2 -a gd:renderSeconds=1.5 -a gd:scene=box \
			R="$i" G="$i*\$x" B=1 dx.R="-$i" dx.G=0 dx.B=0 dy.R=0 dy.G=0 dy.B="$i" Z='3+$y'
	done
}

near() { awk -v a="$1" -v b="$2" 'BEGIN { d = a - b; if (d < 0) d = -d; exit !(d <= 1e-6 * (b < 0 ? -b : b) + 1e-12) }' ||
	{ echo "$1, expected $2"; return 1; }; }

@test "means, variances, bins and samples of five runs" {
	five
	run --separate-stderr "$gdmerge" run?.exr -o out.exr --compression none
	[ "$status" -eq 0 ]
	[ -z "$stderr" ]
	[ -z "$output" ]
	near "$(val out.exr R 1 1)" 3
	near "$(val out.exr G 2 1)" 6
	near "$(val out.exr dx.R 0 0)" -3
	near "$(val out.exr variance.R 0 0)" 0.5	# 2.5 / 5
	near "$(val out.exr dy.variance.B 0 0)" 0.5
	near "$(val out.exr samples 0 0)" 10
	near "$(val out.exr bin4.R 0 0)" 5
	near "$(val out.exr bin2.dy.B 3 2)" 3
	near "$(val out.exr Z 0 2)" 5
	[ "$(val out.exr @gd:bins)" = 5 ]
	[ "$(val out.exr @gd:samplesPerPixel)" = 10 ]
	[ "$(val out.exr @gd:renderSeconds)" = 7.5 ]
	[ "$(val out.exr @gd:scene)" = box ]
	# depth is the same in all runs: no variance for it
	run names out.exr
	[[ "$output" != *Z.variance* ]]
}

@test "merging in steps is merging at once" {
	five
	"$gdmerge" run1.exr run2.exr run3.exr -o a.exr --bins 0
	"$gdmerge" run4.exr run5.exr --bins 0 | "$gdmerge" a.exr - -o out.exr --compression none
	"$gdmerge" run?.exr -o all.exr --compression none
	near "$(val out.exr R 1 1)" 3
	near "$(val out.exr samples 0 0)" 10
	# combined as variances of 6 and 4 samples: 6 * 5 / 3 + 4 * 3 / 4 + 6 * 1 + 4 * 2.25 = 28, over 10 * 9
	near "$(val out.exr variance.R 1 1)" 0.311111111
	near "$(val out.exr dx.R 1 1)" "$(val all.exr dx.R 1 1)"
}

@test "an adaptive second pass" {
	make_exr one.exr 4 3 R=1 G=1 B=1 variance.R=1 variance.G=1 variance.B=1 samples=4
	make_exr two.exr 4 3 R=3 G=3 B=3 variance.R=2 variance.G=2 variance.B=2 samples='4*$x'
	"$gdmerge" one.exr two.exr -o out.exr --compression none --bins 0
	near "$(val out.exr R 0 0)" 1
	near "$(val out.exr R 1 0)" 2
	near "$(val out.exr R 3 2)" 2.5
	near "$(val out.exr variance.R 0 0)" 1
	# 4 and 12 samples: 1 * 4 * 3 + 2 * 12 * 11 + 4 * 1.5^2 + 12 * 0.5^2 = 288, over 16 * 15
	near "$(val out.exr variance.G 3 1)" 1.2
	near "$(val out.exr samples 3 0)" 16
}

@test "--spp for all and for each" {
	make_exr a.exr 2 2 R=0 G=0 B=0
	make_exr b.exr 2 2 R=1 G=1 B=1
	"$gdmerge" a.exr b.exr --spp 4,12 -q -o out.exr --compression none
	near "$(val out.exr R 0 0)" 0.75
	"$gdmerge" a.exr b.exr --spp 4 -o out.exr --compression none
	near "$(val out.exr samples 0 0)" 8
	for bad in 1,2,3 0 -1 nan x 1, , 1e99 1,,2; do
		run --separate-stderr "$gdmerge" a.exr b.exr --spp "$bad" -o bad.exr
		[ "$status" -eq 2 ] || { echo "--spp $bad"; return 1; }
		[[ "$stderr" == "gdmerge: option --spp: '$bad' is "* ]]
		[ ! -e bad.exr ]
	done
}

@test "names of pbrt, with its variance per sample" {
	make_exr p.exr 3 3 -a samplesPerPixel=8 R=1 G=2 B=3 Variance.R=8 Variance.G=16 Variance.B=0 \
		Albedo.R=.5 Albedo.G=.5 Albedo.B=.5 Ns.X=0 Ns.Y=0 Ns.Z=1 N.X=1 N.Y=0 N.Z=0 RelativeVariance.R=1
	run --separate-stderr "$gdmerge" p.exr -o out.exr --compression none
	[ "$status" -eq 0 ]
	[[ "$stderr" == "gdmerge: names of pbrt: "*"albedo from Albedo.{R,G,B}, N from Ns.{X,Y,Z}"*"(variance: sample)" ]]
	near "$(val out.exr variance.G 0 0)" 2
	near "$(val out.exr N.Z 0 0)" 1
	near "$(val out.exr Ng.X 0 0)" 1
	near "$(val out.exr albedo.G 1 1)" 0.5
	run names out.exr
	[[ "$output" != *Relative* && "$output" != *Variance* ]]
	# -q is silent, --variance overrules
	run --separate-stderr "$gdmerge" -q p.exr -o out.exr --compression none --variance mean
	[ -z "$stderr" ]
	near "$(val out.exr variance.G 0 0)" 16
	run names out.exr
	"$gdmerge" -q p.exr -o out.exr --compression none --variance none
	run names out.exr
	[[ "$output" != *variance* ]]
}

@test "names of Blender, and --map" {
	make_exr b.exr 3 3 "-a" "cycles.V L.samples=16" "V L.Combined.R=1" "V L.Combined.G=2" "V L.Combined.B=3" \
		"V L.Denoising Normal.X=0" "V L.Denoising Normal.Y=0" "V L.Denoising Normal.Z=1" \
		"V L.Own Colour.R=4" "V L.Own Colour.G=5" "V L.Own Colour.B=6" "V L.CryptoObject00.r=1e-30"
	run --separate-stderr "$gdmerge" b.exr --map 'albedo=V L.Own Colour.{R,G,B}' -o out.exr --compression none
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"colour from V L.Combined.{R,G,B}"* ]]
	near "$(val out.exr G 0 0)" 2
	near "$(val out.exr albedo.B 0 0)" 6
	near "$(val out.exr N.Z 0 0)" 1
	near "$(val out.exr samples 0 0)" 16
	[ "$(val out.exr 'V L.CryptoObject00.r' 2 2)" = "$(val b.exr 'V L.CryptoObject00.r' 2 2)" ]
	run --separate-stderr "$gdmerge" b.exr --map 'albedo=Nothing.{R,G,B}' -o bad.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdmerge: b.exr: no channel Nothing.R (--map albedo=Nothing.{R,G,B})" ]
	run --separate-stderr "$gdmerge" b.exr --names blender -o bad.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdmerge: option --names: 'blender' is none of the renderers known" ]
	run --separate-stderr "$gdmerge" b.exr --variance x -o bad.exr
	[ "$stderr" = "gdmerge: option --variance: 'x' is none of auto, mean, sample, m2, none" ]
	[ ! -e bad.exr ]
}

@test "Blender's motion vectors, and its sample count as a share" {
	for i in 1 2; do
		make_exr b$i.exr 3 3 -a cycles.V.samples=16 V.Combined.R=$i V.Combined.G=2 V.Combined.B=3 \
			V.Vector.X=$i V.Vector.Y=2 V.Vector.Z=3 V.Vector.W=4 "V.Debug Sample Count.X=\$x ? 1 : 0.25"
	done
	"$gdmerge" -q b1.exr b2.exr -o out.exr --compression none
	near "$(val out.exr V.Vector.X 0 0)" 1.5
	near "$(val out.exr V.Vector.W 0 0)" 4
	near "$(val out.exr samples 0 0)" 8
	near "$(val out.exr samples 1 0)" 32
	near "$(val out.exr variance.R 0 0)" 0.25
	# any number of components
	make_exr six.exr 2 2 R=1 G=1 B=1 L.R=1 L.G=2 L.B=3 L.X=4 L.Y=5 L.Z=6
	"$gdmerge" -q six.exr six.exr --bins 0 -o out.exr --compression none
	for c in R.1 G.2 B.3 X.4 Y.5 Z.6; do near "$(val out.exr "L.${c%.*}" 1 1)" "${c#*.}"; done
}

@test "names are told when all went well, else one line says what is wrong" {
	make_exr m.exr 2 2 R=1 G=1 B=1 m2_R=2 m2_G=2 m2_B=2
	run --separate-stderr "$gdmerge" m.exr -o out.exr
	[ "$status" -eq 2 ]
	[ "${#stderr_lines[@]}" -eq 1 ]
	run --separate-stderr "$gdmerge" m.exr --spp 4 -o out.exr
	[ "$status" -eq 0 ]
	[ "$stderr" = "gdmerge: names of mitsuba: colour variance from m2_{R,G,B} (variance: m2)" ]
}

@test "NaN and Inf are left out, counted and told" {
	make_exr a.exr 4 3 -a gd:samplesPerPixel=1 R='$x == 1 ? nan() : 1' G=1 B=1
	make_exr b.exr 4 3 -a gd:samplesPerPixel=1 R=3 G=3 B='$x == 1 && $y == 1 ? -inf() : 3'
	run --separate-stderr "$gdmerge" a.exr b.exr -o out.exr --compression none --stats s.json
	[ "$status" -eq 0 ]
	[[ "${stderr_lines[0]}" == "gdmerge: warning: 4 pixels with NaN or Inf in one input left out"* ]]
	[[ "${stderr_lines[1]}" == "gdmerge: warning: 1 pixels have no sample in any input and are 0" ]]
	grep -q '"dropped_pixels": 4, "empty_pixels": 1' s.json
	near "$(val out.exr R 0 0)" 2
	near "$(val out.exr G 1 0)" 3
	near "$(val out.exr G 1 1)" 0
	[[ "$(val out.exr variance.R)" != *[nN]a[nN]* ]]
	# counts that are none: not for weights, or cut
	make_exr a.exr 4 3 R=1 G=1 B=1 samples='$x == 1 ? nan() : $x == 2 ? -4 : 4'
	make_exr b.exr 4 3 R=5 G=5 B=5 samples='$x == 3 ? 3e38 : 4'
	"$gdmerge" -q a.exr b.exr -o out.exr --compression none
	[ "$(val out.exr R 0 1)" = 3 ]
	[ "$(val out.exr R 1 1)" = 5 ]
	[ "$(val out.exr R 2 1)" = 5 ]
	[ "$(val out.exr R 3 1)" = 5 ]
	[ "$(val out.exr samples 1 1)" = 4 ]
}

@test "a variance of the wrong kind is noticed" {
	for i in 1 2 3 4 5 6; do
		make_exr "v$i.exr" 16 16 -s "$i" -a gd:samplesPerPixel=64 R='1+noise()/8' G='1+noise()/8' B='1+noise()/8' \
			variance.R=1 variance.G=1 variance.B=1
	done
	run --separate-stderr "$gdmerge" v?.exr -o out.exr
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"the inputs' own standard deviation is "*"is --variance right?" ]]
	run --separate-stderr "$gdmerge" v?.exr --variance sample -o out.exr
	[ "$status" -eq 0 ]
	[ -z "$stderr" ]
}

@test "--halves for a reference, --bins" {
	five
	"$gdmerge" run?.exr --bins 0 --halves -o out.exr --compression none
	near "$(val out.exr half0.R 0 0)" 3
	near "$(val out.exr half1.R 0 0)" 3
	near "$(val out.exr half1.dx.R 0 0)" -3
	run names out.exr
	[[ "$output" != *bin* ]]
	"$gdmerge" run?.exr --bins 5 -o out.exr --compression none
	[ "$(val out.exr @gd:bins)" = 5 ]
	run --separate-stderr "$gdmerge" run?.exr --bins 6 -o bad.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdmerge: 6 bins cannot be made of 5 independent parts" ]
	run --separate-stderr "$gdmerge" run1.exr --halves -o bad.exr
	[ "$stderr" = "gdmerge: run1.exr: halves need two inputs, or bins" ]
}

@test "unequal bins bring a warning" {
	make_exr a.exr 2 2 R=0 G=0 B=0
	make_exr b.exr 2 2 R=1 G=1 B=1
	run --separate-stderr "$gdmerge" a.exr b.exr --spp 1,3 -o out.exr
	[ "$stderr" = "gdmerge: warning: the fullest bin has 3 times the samples of the emptiest" ]
}

@test "what does not fit is named" {
	make_exr a.exr 4 3 R=1 G=1 B=1
	make_exr b.exr 3 4 R=1 G=1 B=1
	make_exr c.exr 4 3 Z=1
	run --separate-stderr "$gdmerge" a.exr b.exr -o out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdmerge: b.exr: 3 x 4 pixels, expected 4 x 3 as in a.exr" ]
	run --separate-stderr "$gdmerge" c.exr -o out.exr
	[ "$stderr" = "gdmerge: c.exr: no colour, neither R G B nor another name that is known" ]
	run --separate-stderr bash -c "'$gdmerge' a.exr - - -o out.exr <a.exr"
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdmerge: standard input is named twice" ]
	make_exr moved.exr 4 3 -o 1,0 R=1 G=1 B=1
	run --separate-stderr "$gdmerge" a.exr moved.exr -o out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdmerge: moved.exr: data window at (1, 0), expected (0, 0) as in a.exr" ]
	head -c 300 a.exr >cut.exr
	run --separate-stderr "$gdmerge" a.exr cut.exr -o out.exr
	[ "$status" -eq 2 ]
	[ "${#stderr_lines[@]}" -eq 1 ]
	[[ "$stderr" == "gdmerge: cut.exr: "* ]]
	[ ! -e out.exr ]
}

@test "shapes of one pixel and one line, grey colour" {
	for size in "1 1" "1 7" "7 1"; do
		for i in 1 2; do make_exr "s$i.exr" $size Y="$i"; done
		"$gdmerge" -q s1.exr s2.exr -o out.exr --compression none
		near "$(val out.exr G)" 1.5
		near "$(val out.exr variance.B)" 0.25
	done
}

@test "the data window stays" {
	for i in 1 2; do make_exr "w$i.exr" 4 3 -o -5,7 R="$i" G=0 B=0; done
	"$gdmerge" w1.exr w2.exr -o out.exr --compression none
	[ "$(val out.exr @dataWindow | od -An -td4 -N16 | tr -s ' ')" = " -5 7 -2 9" ]
	near "$(val out.exr R 3 2)" 1.5
}

@test "the same colours twice bring a warning, and -v tells where; black frames do not" {
	make_exr a.exr 4 3 -a gd:samplesPerPixel=2 R='$x+$y' G=1 B=1
	make_exr b.exr 4 3 -a gd:samplesPerPixel=2 R='$x+2*$y' G=1 B=1
	cp a.exr twin.exr
	run --separate-stderr "$gdmerge" a.exr b.exr twin.exr a.exr -o out.exr --stats s.json
	[ "$status" -eq 0 ]
	[ "$stderr" = "gdmerge: warning: inputs whose colours are those of an earlier one, bit by bit: 2; the same seed twice? (-v tells which)" ]
	grep -q '"twin_inputs": 2' s.json
	run --separate-stderr "$gdmerge" -v a.exr b.exr twin.exr -o out.exr
	[[ "$stderr" == *"gdmerge: twin.exr: the same colours as a.exr"* ]]
	run --separate-stderr "$gdmerge" -q a.exr twin.exr -o out.exr
	[ -z "$stderr" ]
	make_exr black.exr 4 3 R=0 G=0 B=0
	run --separate-stderr "$gdmerge" black.exr black.exr a.exr b.exr -o out.exr --stats s.json --spp 2
	[ "$status" -eq 0 ]
	[ -z "$stderr" ]
	grep -q '"twin_inputs": 0' s.json
}
