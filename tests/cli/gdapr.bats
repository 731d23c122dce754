#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause

setup() {
	bats_require_minimum_version 1.5.0
	top=$BATS_TEST_DIRNAME/../..
	gdapr=$(realpath "${GD_BIN:-$top/bin}")/gdapr
	support=$(realpath "$top/tests/support")
	cd "$BATS_TEST_TMPDIR"
}

val() { "$support/exrval.pl" "$@"; }
names() { "$support/exrval.pl" "$1" | sed 's/:.*//' | sort | tr '\n' ' '; }

# Two regions, two bins with noise of variance 1/3 each times 0.04, an albedo that knows the regions, a noisy
# depth, a layer.
frame() {
	n0='my $a = sin($x * 12.9 + $y * 78.2) * 437.5; $a -= int $a;'
	n1='my $b = sin($x * 39.3 + $y * 11.1) * 911.3; $b -= int $b;'
	"$support/mkexr.pl" "$1" 40 30 \
		R="$n0 $n1 1 + 2 * (\$x > \$y) + 0.1 * (\$a + \$b)" G="$n0 $n1 1 + 0.02 * \$x + 0.1 * (\$a + \$b)" B=0.5 \
		bin0.R="$n0 1 + 2 * (\$x > \$y) + 0.2 * \$a" bin0.G="$n0 1 + 0.02 * \$x + 0.2 * \$a" bin0.B=0.5 \
		bin1.R="$n1 1 + 2 * (\$x > \$y) + 0.2 * \$b" bin1.G="$n1 1 + 0.02 * \$x + 0.2 * \$b" bin1.B=0.5 \
		variance.R=0.0067 variance.G=0.0067 variance.B=0 \
		albedo.R='$x > $y' albedo.G='$x > $y' albedo.B=0.5 Z='5 + 0.1 * $y + 0.05 * noise()' Z.variance=0.0025 \
		light.R='0.5 + $x / 80' light.G=0.25 light.B='0.1 * noise()' \
		dx.R=0 dx.G=0 dx.B=0 dy.R=0 dy.G=0 dy.B=0 samples=16 A='$x / 40' crypto00.R='$x * $y'
}

near() { awk -v a="$1" -v b="$2" -v t="$3" 'BEGIN { d = a - b; exit !((d < 0 ? -d : d) <= t) }' ||
	{ echo "$1, expected $2 within $3"; return 1; }; }

@test "noise goes, the mean stays, used channels are gone, others stay" {
	frame in.exr
	run --separate-stderr "$gdapr" in.exr out.exr --compression none
	[ "$status" -eq 0 ]
	[ -z "$output" ]
	[ -z "$stderr" ]
	near "$(val out.exr R 30 10)" 3 0.1
	near "$(val out.exr R 10 20)" 1 0.1
	near "$(val out.exr R)" "$(val in.exr R)" 0.005
	near "$(val out.exr A 20 3)" 0.5 0
	near "$(val out.exr crypto00.R 6 7)" 42 0
	run names out.exr
	for c in A R error.R light.B crypto00.R samples; do
		[[ " $output" == *" $c "* ]]
	done
	for c in albedo Z variance dx bin; do
		[[ " $output" != *" $c"* ]]
	done
	"$gdapr" --single in.exr out.exr --compression none
	[ "$(names out.exr)" = "A B G R crypto00.R error.B error.G error.R light.B light.G light.R model.columns model.order samples " ]
	near "$(val out.exr R 30 10)" 3 0.1
	awk -v e="$(val out.exr error.R)" 'BEGIN { exit !(e > 0 && e < 0.01) }'
}

@test "--keep keeps what was used" {
	frame in.exr
	"$gdapr" --keep in.exr out.exr --compression none
	for c in albedo.R Z Z.variance variance.R dx.R bin0.R bin1.G; do
		[ "$(val out.exr "$c" 11 7)" = "$(val in.exr "$c" 11 7)" ]
		[ "$(val out.exr "$c")" = "$(val in.exr "$c")" ]
	done
}

@test "the methods and their settings" {
	frame in.exr
	for o in --fast --single --paper "--paper -r 8" "-r 0" "-r 3 --step 7" "--order 0" "--order-min 2" "--kernel box" "--spikes drop" \
		"--spikes keep" --no-filter "-f none" "-f albedo" "-f Z,albedo"; do
		"$gdapr" $o in.exr out.exr --compression none
		near "$(val out.exr R)" "$(val in.exr R)" 0.02
	done
	"$gdapr" --order 0 in.exr out.exr --compression none
	[ "$(val out.exr model.order)" = 0 ]
	"$gdapr" --order-min 2 --order 2 in.exr out.exr --compression none
	near "$(val out.exr model.order)" 2 1e-6
	"$gdapr" -f albedo --order 0 in.exr out.exr --compression none
	near "$(val out.exr model.columns 30 29)" 2 0.01	# 1 and albedo.R
}

@test "layers add up as before" {
	"$support/mkexr.pl" in.exr 30 20 R='1 + noise()' G=1 B=1 variance.R=1 variance.G=0 variance.B=0 \
		light.R='0.5 * $x / 30' light.G=0 light.B=0 depth='$y'
	"$gdapr" -f none --spikes keep in.exr a.exr --compression none
	"$gdapr" -f none --spikes keep --layers light,depth in.exr b.exr --compression none
	[ "$(val a.exr R 11 7)" = "$(val b.exr R 11 7)" ]
	near "$(val b.exr light.R 12 9)" 0.2 0.05
	near "$(val b.exr depth 12 9)" 9 0.5
	near "$(val a.exr light.R 12 9)" 0.2 1e-6
}

@test "a pipe, and any number of threads: the same bytes" {
	frame in.exr
	export SOURCE_DATE_EPOCH=0
	for j in 1 2 7; do
		"$gdapr" -j "$j" <in.exr | sed 's/-j [127]/-j N/' >"out$j.exr"
	done
	cmp out1.exr out2.exr
	cmp out1.exr out7.exr
}

@test "no variance: from bins, else from the image" {
	"$support/mkexr.pl" bins.exr 30 20 R=1 G=1 B=1 bin0.R=1.5 bin0.G=1 bin0.B=1 bin1.R=0.5 bin1.G=1 bin1.B=1
	"$gdapr" -q bins.exr out.exr --compression none
	near "$(val out.exr R 5 5)" 1 1e-5
	"$support/mkexr.pl" bare.exr 30 20 R='1 + 0.1 * noise()' G=1 B=1
	run --separate-stderr "$gdapr" -v bare.exr out.exr --compression none
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"7x7 windows of the image"* ]]
	near "$(val out.exr R)" 1 0.02
}

@test "NaN and Inf are filled in and counted" {
	"$support/mkexr.pl" in.exr 20 20 R='$x == 4 && $y == 5 ? nan() : 1' G='$x == 9 ? inf() : 1' B=1 \
		variance.R=0.01 variance.G=0.01 variance.B='$y ? 0.01 : nan()' Z='$x == $y ? nan() : $x'
	run --separate-stderr "$gdapr" in.exr out.exr --compression none
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"41 values that were NaN or Inf were filled in"* ]]
	near "$(val out.exr R)" 1 1e-5
	near "$(val out.exr G)" 1 1e-5
}

@test "--single: a firefly gives its energy back, up to twice the light around it" {
	"$support/mkexr.pl" in.exr 41 41 R='$x == 20 && $y == 20 ? 101 : 1' G=1 B=1 \
		variance.R='$x == 20 && $y == 20 ? 10000 : 0.0001' variance.G=0 variance.B=0
	"$gdapr" --single in.exr out.exr --compression none
	near "$(val out.exr R)" "$(val in.exr R)" 1e-4
	near "$(val out.exr R 20 20)" 1.2268 0.01	# 100 over 21x21 pixels
	"$gdapr" --spikes drop in.exr out.exr --compression none
	near "$(val out.exr R)" 1 1e-4
	"$support/mkexr.pl" in.exr 41 41 R='$x == 20 && $y == 20 ? 1e30 : 1' G=1 B=1 \
		variance.R='$x == 20 && $y == 20 ? inf() : 0.0001' variance.G=0 variance.B=0
	"$gdapr" --single in.exr out.exr --compression none
	awk -v r="$(val out.exr R 20 20)" 'BEGIN { exit !(r < 20) }'
}

@test "what is missing is named; exit 2, no output" {
	"$support/mkexr.pl" in.exr 5 5 R=1 B=1
	for t in "no channel G|" "no feature layer albedo|-f albedo" "no layer diffuse|-l diffuse"; do
		[ "${t%%|*}" = "no channel G" ] || "$support/mkexr.pl" in.exr 5 5 R=1 G=1 B=1
		run --separate-stderr "$gdapr" ${t##*|} in.exr out.exr
		[ "$status" -eq 2 ]
		[ -z "$output" ]
		[ "$stderr" = "gdapr: in.exr: ${t%%|*}" ]
		[ ! -e out.exr ]
	done
}

@test "options out of range" {
	frame in.exr
	for o in "-r 65" "--order 4" "--order-min 2 --order 1" "--step 0" "-r 2 --step 6" "--kernel disc" "--spikes away"; do
		run --separate-stderr "$gdapr" $o in.exr out.exr
		[ "$status" -eq 2 ]
		[ -n "$stderr" ]
		[ "${#stderr_lines[@]}" -le 2 ]
		[ ! -e out.exr ]
	done
}

@test "layers that cannot be denoised are named" {
	frame in.exr
	for t in "layer Z is a feature: it cannot be denoised, too|-l Z" "layer light is named twice|-l light,light"; do
		run --separate-stderr "$gdapr" ${t##*|} in.exr out.exr
		[ "$status" -eq 2 ]
		[[ "$stderr" == *"${t%%|*}"* ]]
	done
}

@test "--fast is not for a single regression" {
	frame in.exr
	for o in --single --paper "-r 3"; do
		run --separate-stderr "$gdapr" --fast $o in.exr out.exr
		[ "$status" -eq 2 ]
		[[ "$stderr" == *"--fast is for cross-fitting"* ]]
	done
}

@test "model.spread of several models, none of one" {
	frame in.exr
	"$gdapr" in.exr out.exr --compression none
	awk -v s="$(val out.exr model.spread)" 'BEGIN { exit !(s > 0 && s < 0.1) }'
	"$gdapr" --fast in.exr out.exr --compression none
	[[ " $(names out.exr)" != *" model."* ]]
}

@test "real renders: relMSE below what was measured and a tenth" {
	data=$(realpath "${GD_TESTDATA:-$top/testdata}")
	"$gdapr" "$data/kitchen/path16eq.exr" out.exr
	"${gdapr%gdapr}gdrelmse" -r "$data/kitchen/reference.exr" out.exr --max 0.0064	# noisy: 0.0369
}

@test "one pixel, one row, one column" {
	for s in "1 1" "1 9" "9 1" "2 2"; do
		"$support/mkexr.pl" in.exr $s R='1 + $x + $y' G=1 B=1 variance.R=0.01 variance.G=0.01 variance.B=0.01 Z='$x'
		"$gdapr" in.exr out.exr --compression none
		near "$(val out.exr G)" 1 1e-3
	done
}

@test "figures for --stats" {
	frame in.exr
	"$gdapr" in.exr out.exr --stats s.json
	grep -q '"spikes": *[0-9]' s.json
	grep -q '"mended": *0' s.json
}

@test "a feature of all samples is no feature beside bins of the colour, unless named" {
	PATH=${gdapr%/*}:$PATH
	gdbag -q "${GD_TESTDATA:-$top/testdata}/kitchen/gpt16.exr" bag.exr
	gdapr -v bag.exr auto.exr 2>said
	run ! grep -q "feature feature" said
	gdapr -v -f albedo,N,Z,feature bag.exr named.exr 2>said
	grep -q "feature feature" said
	gdapr --paper -v bag.exr paper.exr 2>said
	grep -q "feature feature" said
	SOURCE_DATE_EPOCH=1 gdapr -q -f albedo,N,Z bag.exr without.exr
	run gdrelmse -q --max 1e-12 -r without.exr auto.exr
	[ "$status" -eq 0 ]
}

# pan N FILE: two bins of noise of their own on a checker board that moves two pixels a frame, with positions.
pan() {
	local b at="(\$x + 2 * $1)" parts=()
	for b in 0 1; do
		parts+=("bin$b.R=1 + int($at / 8) % 2 + 0.3 * noise()" bin$b.G="1 + 0.2 * noise()" bin$b.B="0.5 + 0.1 * noise()")
	done
	"$support/mkexr.pl" "$2" 48 24 -s $1 "${parts[@]}" R="1 + int($at / 8) % 2" G=1 B=0.5 Z="int($at / 8) % 2" \
		P.X="$at" P.Y='$y' P.Z=1 unused.R=1 unused.G=1 unused.B=1
}

@test "--neighbours: frames before and after lower the noise" {
	for i in 0 1 2; do pan $i f$i.exr; done
	pan 1 want.exr
	PATH=${gdapr%/*}:$PATH
	"$gdapr" f1.exr alone.exr --compression none
	"$gdapr" f1.exr with.exr --compression none --stats s.json --neighbours f0.exr f2.exr
	grep -q '"frames": 3' s.json
	error() { gdrelmse -q --format tsv -r want.exr "$1" | awk -F'\t' 'NR == 2 { print $2 }'; }
	awk -v a="$(error alone.exr)" -v b="$(error with.exr)" 'BEGIN { exit !(b < 0.8 * a) }' || { error alone.exr; error with.exr; return 1; }
	[ "$(names alone.exr)" = "$(names with.exr)" ]	# P is gone, what is not known stays
	[[ " $(names with.exr)" == *" unused.R "* ]]
	# in any order
	"$gdapr" f1.exr turned.exr --compression none --neighbours f2.exr f0.exr
	near "$(val with.exr R 20 11)" "$(val turned.exr R 20 11)" 0.02
	# without positions: the same pixels are looked at
	"$support/mkexr.pl" still.exr 48 24 R=1 G=1 B=0.5 bin0.R=1 bin0.G=1 bin0.B=0.5 bin1.R=1 bin1.G=1 bin1.B=0.5 Z=0
	"$gdapr" -v f1.exr out.exr --neighbours still.exr 2>said
	grep -q "without world positions" said
}

@test "--neighbours: what does not fit is named with its file" {
	pan 0 in.exr
	cp in.exr too.exr
	"$support/mkexr.pl" small.exr 5 4 R=1 G=1 B=1
	"$support/mkexr.pl" bare.exr 48 24 R=1 G=1 B=1 Z=1
	"$support/mkexr.pl" blind.exr 48 24 R=1 G=1 B=1 bin0.R=1 bin0.G=1 bin0.B=1 bin1.R=1 bin1.G=1 bin1.B=1
	"$support/mkexr.pl" grey.exr 48 24 R=1 B=1
	for t in "small.exr: 5 x 4 pixels, expected 48 x 24" "bare.exr: no halves and no bins, which the frame to denoise has" \
		"blind.exr: no layer Z, which the frame to denoise has" "grey.exr: no channel G" "nowhere.exr: No such file or directory"; do
		run -2 --separate-stderr "$gdapr" in.exr out.exr --neighbours too.exr "${t%%:*}"
		[ "$stderr" = "gdapr: $t" ] || { echo "$stderr"; return 1; }
		[ ! -e out.exr ]
	done
	run -2 --separate-stderr "$gdapr" in.exr out.exr --neighbours in.exr in.exr in.exr in.exr in.exr
	[ "$stderr" = "gdapr: --neighbours: 5 files, at most 4" ]
	run -2 --separate-stderr "$gdapr" --paper in.exr out.exr --neighbours in.exr
	[[ "$stderr" == *"--neighbours is for cross-fitting"* ]]
	run -2 --separate-stderr bash -c "'$gdapr' -o out.exr --neighbours - <in.exr"
	[ "$stderr" = "gdapr: --neighbours -: standard input is the frame to denoise" ]
	run -2 --separate-stderr "$gdapr" in.exr out.exr --neighbours too.exr ./in.exr
	[ "$stderr" = "gdapr: --neighbours ./in.exr: the frame itself" ]
	run -2 --separate-stderr "$gdapr" in.exr out.exr --neighbours too.exr ./too.exr
	[ "$stderr" = "gdapr: --neighbours ./too.exr: named twice" ]
	[ ! -e out.exr ]
}

@test "the manual lists the options in the order of -h" {
	"$gdapr" -h | sed -nE 's/^  (-[a-zA-Z], |    )--([a-z0-9-]+).*/\2/p' >help
	sed -nE 's/^\.It (.*[ ,])?-([a-z-]{2,}).*/\2/p' "$top/man/gdapr.1" >manual
	diff help manual
}
