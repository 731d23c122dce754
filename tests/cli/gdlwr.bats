#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause

setup() {
	bats_require_minimum_version 1.5.0
	top=$BATS_TEST_DIRNAME/../..
	gdlwr=$(realpath "${GD_BIN:-$top/bin}")/gdlwr
	support=$(realpath "$top/tests/support")
	data=$(realpath "${GD_TESTDATA:-$top/testdata}")
	cd "$BATS_TEST_TMPDIR"
}

val() { "$support/exrval.pl" "$@"; }
names() { "$support/exrval.pl" "$1" | sed 's/:.*//' | sort | tr '\n' ' '; }

# Two regions, two bins of noise, an albedo that knows the regions, a noisy depth, a layer, positions.
frame() {
	n0='my $a = sin($x * 12.9 + $y * 78.2) * 437.5; $a -= int $a;'
	n1='my $b = sin($x * 39.3 + $y * 11.1) * 911.3; $b -= int $b;'
	"$support/mkexr.pl" "$1" 40 30 \
		R="$n0 $n1 1 + 2 * (\$x > \$y) + 0.1 * (\$a + \$b)" G="$n0 $n1 1 + 0.02 * \$x + 0.1 * (\$a + \$b)" B=0.5 \
		bin0.R="$n0 1 + 2 * (\$x > \$y) + 0.2 * \$a" bin0.G="$n0 1 + 0.02 * \$x + 0.2 * \$a" bin0.B=0.5 \
		bin1.R="$n1 1 + 2 * (\$x > \$y) + 0.2 * \$b" bin1.G="$n1 1 + 0.02 * \$x + 0.2 * \$b" bin1.B=0.5 \
		variance.R=0.0067 variance.G=0.0067 variance.B=0 \
		albedo.R='$x > $y' albedo.G='$x > $y' albedo.B=0.5 Z='5 + 0.1 * $y + 0.05 * noise()' Z.variance=0.0025 \
		light.R='0.5 + $x / 80' light.G=0.25 light.B='0.1 * noise()' P.X='$x / 10' P.Y='$y / 10' P.Z=3 \
		dx.R=0 dx.G=0 dx.B=0 dy.R=0 dy.G=0 dy.B=0 samples=16 A='$x / 40' crypto00.R='$x * $y'
}

near() { awk -v a="$1" -v b="$2" -v t="$3" 'BEGIN { d = a - b; exit !((d < 0 ? -d : d) <= t) }' ||
	{ echo "$1, expected $2 within $3"; return 1; }; }

# refused STATUS-LINE ARGUMENTS...: one line, exit 2, no output
refused() {
	local line=$1
	shift
	run --separate-stderr "$gdlwr" "$@" out.exr
	[ "$status" -eq 2 ]
	[ -z "$output" ]
	[ ! -e out.exr ]
	[ "$stderr" = "gdlwr: $line" ] || { echo "$stderr"; return 1; }
}

@test "noise goes, the mean stays, used channels are gone, others stay" {
	frame in.exr
	run --separate-stderr "$gdlwr" in.exr out.exr --compression none
	[ "$status" -eq 0 ]
	[ -z "$output" ]
	[ -z "$stderr" ]
	near "$(val out.exr R 30 10)" 3 0.1
	near "$(val out.exr R 10 20)" 1 0.1
	near "$(val out.exr R)" "$(val in.exr R)" 0.01
	near "$(val out.exr A 20 3)" 0.5 0
	near "$(val out.exr crypto00.R 6 7)" 42 0
	[ "$(names out.exr)" = "A B G R crypto00.R error.B error.G error.R light.B light.G light.R model.centre model.features model.radius model.spread samples " ]
	awk -v e="$(val out.exr error.R)" 'BEGIN { exit !(e >= 0 && e < 0.01) }'
}

@test "--keep keeps what was used" {
	frame in.exr
	for o in "" --paper "--state"; do
		# shellcheck disable=SC2086
		"$gdlwr" --keep $o in.exr out.exr --compression none
		for c in albedo.R Z Z.variance variance.R dx.R bin0.R bin1.G P.X; do
			[ "$(val out.exr "$c" 11 7)" = "$(val in.exr "$c" 11 7)" ]
			[ "$(val out.exr "$c")" = "$(val in.exr "$c")" ]
		done
	done
}

@test "the methods and their settings" {
	frame in.exr
	for o in --paper --dense "--paper --dense" "-r 1" "-r 15" "--granularity 1" "-r 3 --granularity 7" --no-filter "-f none" \
		"-f albedo" "-f Z,albedo,P"; do
		# shellcheck disable=SC2086
		"$gdlwr" $o in.exr out.exr --compression none
		near "$(val out.exr R)" "$(val in.exr R)" 0.02
	done
}

@test "models: one at every pixel if dense, few else, none wider than allowed" {
	frame in.exr
	"$gdlwr" --dense in.exr out.exr --compression none
	near "$(val out.exr model.centre)" 1 0
	"$gdlwr" in.exr out.exr --compression none --stats s.json
	awk -v c="$(val out.exr model.centre)" 'BEGIN { exit !(c > 0.001 && c < 0.5) }'
	near "$(sed 's/.*"share": \([0-9.e-]*\).*/\1/' s.json)" "$(val out.exr model.centre)" 1e-5
	for y in 3 17 29; do
		awk -v r="$(val out.exr model.radius 20 $y)" 'BEGIN { exit !(r >= 0 && r <= 9) }'
	done
	"$gdlwr" -r 2 in.exr out.exr --compression none
	awk -v r="$(val out.exr model.radius)" 'BEGIN { exit !(r > 0 && r <= 2) }'
	auto=$(val out.exr model.features)
	"$gdlwr" -r 2 -f none in.exr out.exr --compression none
	awk -v a="$auto" -v n="$(val out.exr model.features)" 'BEGIN { exit !(n < a) }'
}

@test "layers add up as before" {
	parts=()
	for b in 0 1; do
		n="my \$n = sin(\$x * 12.9 + \$y * 78.2 + $b) * 437.5; \$n -= int \$n;"
		parts+=("bin$b.R=$n 1 + \$x / 30 + 0.2 * \$n" bin$b.G=1 bin$b.B=0.5
			"bin$b.light.R=$n \$x / 30 + 0.3 * \$n" bin$b.light.G=0.75 bin$b.light.B=0
			"bin$b.rest.R=$n 1 - 0.1 * \$n" bin$b.rest.G=0.25 bin$b.rest.B=0.5)
	done
	"$support/mkexr.pl" in.exr 30 20 R='1 + $x / 30' G=1 B=0.5 light.R='$x / 30' light.G=0.75 light.B=0 rest.R=1 rest.G=0.25 \
		rest.B=0.5 "${parts[@]}"
	"$gdlwr" -l light,rest in.exr out.exr --compression none
	for at in "3 4" "12 9" "29 19"; do
		# shellcheck disable=SC2086
		near "$(val out.exr R $at)" "$(awk -v a="$(val out.exr light.R $at)" -v b="$(val out.exr rest.R $at)" 'BEGIN { print a + b }')" 2e-5
	done
	near "$(val out.exr light.R 12 9)" 0.4 0.1
	# one that is not named stays as it is; layers without bins of their own are smoothed whole
	"$gdlwr" -l light in.exr out.exr --compression none
	near "$(val out.exr rest.R 12 9)" 1 0
	"$support/mkexr.pl" in.exr 30 20 R='1 + noise()' G=1 B=1 variance.R=1 variance.G=0 variance.B=0 light.R='0.5 * $x / 30' light.G=0 \
		light.B=0 depth='$y' bin0.R='1 + noise()' bin0.G=1 bin0.B=1 bin1.R='1 + noise()' bin1.G=1 bin1.B=1
	"$gdlwr" -f none --layers light,depth in.exr out.exr --compression none
	near "$(val out.exr light.R 12 9)" 0.2 0.05
	near "$(val out.exr depth 12 9)" 9 0.5
}

@test "a pipe, and any number of threads: the same bytes" {
	frame in.exr
	export SOURCE_DATE_EPOCH=0
	for o in "" --dense --paper --state; do
		for j in 1 2 7; do
			# shellcheck disable=SC2086
			"$gdlwr" $o -j "$j" <in.exr | sed 's/-j [127]/-j N/' >"out$j.exr"
		done
		[ "$(val out1.exr B 3 3)" != "" ]
		cmp out1.exr out2.exr
		cmp out1.exr out7.exr
	done
}

@test "no halves, no variance: from the image" {
	"$support/mkexr.pl" bare.exr 30 20 R='1 + 0.1 * noise()' G=1 B=1
	run --separate-stderr "$gdlwr" -v bare.exr out.exr --compression none --stats s.json
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"7x7 windows of the image"* ]]
	near "$(val out.exr R)" 1 0.02
	grep -q '"method": "whole"' s.json
}

@test "NaN and Inf are filled in and counted" {
	"$support/mkexr.pl" in.exr 20 20 R='$x == 4 && $y == 5 ? nan() : 1' G='$x == 9 ? inf() : 1' B=1 \
		variance.R=0.01 variance.G=0.01 variance.B='$y ? 0.01 : nan()' Z='$x == $y ? nan() : $x'
	run --separate-stderr "$gdlwr" in.exr out.exr --compression none
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"41 values that were NaN or Inf were filled in"* ]]
	near "$(val out.exr R)" 1 1e-5
	near "$(val out.exr G)" 1 1e-5
}

@test "-v and --stats tell of models, radius, features, seconds" {
	frame in.exr
	run --separate-stderr "$gdlwr" -v in.exr out.exr --stats s.json
	[[ "$stderr" == *" models of both halves: one for "*" % of the pixels; mean radius "*" features in use"* ]]
	[[ "$stderr" == *" s for features, "*" s for the models"* ]]
	for key in '"method": "crossfit"' '"models": [0-9]' '"share": [0-9.]' '"meanRadius": [0-9]' '"meanFeatures": [0-9]' \
		'"mended": 0' '"filterSeconds": [0-9]' '"fitSeconds": [0-9]'; do
		grep -q "$key" s.json
	done
	run ! grep -q meanFrames s.json
}

@test "what is missing is named; exit 2, no output" {
	"$support/mkexr.pl" in.exr 5 5 R=1 B=1
	refused "in.exr: no channel G" in.exr
	"$support/mkexr.pl" in.exr 5 5 R=1 G=1 B=1 Z=1
	refused "in.exr: no feature layer albedo" -f albedo in.exr
	refused "in.exr: no layer diffuse" -l diffuse in.exr
	refused "layer Z is a feature: it cannot be denoised, too" -l Z in.exr
	refused "in.exr: no layer P: frames of a sequence are joined by world positions" --state in.exr
}

@test "settings that do not go together" {
	frame in.exr
	refused "--granularity is for sparse models: it does not go with --dense" --dense --granularity 3 in.exr
	refused "--granularity 8 leaves gaps between windows of radius 3" -r 3 --granularity 8 in.exr
	refused "layers of a sequence: only the colour can be filtered along time" --state -l light in.exr
	refused "layer R is the colour" -l R in.exr
	refused "layer light.R is named twice" -l light,light.R in.exr
	refused "layer albedo.R is a feature: it cannot be denoised, too" -l albedo.R in.exr
	for o in "-r 16" "-r 0" "--granularity 32" "--forget 0.4" "--forget 1.1"; do
		# shellcheck disable=SC2086
		run --separate-stderr "$gdlwr" $o in.exr out.exr
		[ "$status" -eq 2 ]
		[[ "$stderr" == *"is not in"* ]]
		[ ! -e out.exr ]
	done
}

@test "a sequence: the state goes from frame to frame, and what stands still gets better" {
	frame in.exr
	"$gdlwr" --state in.exr a.exr --compression none
	near "$(val a.exr state.frames)" 1 0
	near "$(val a.exr state.value.R 30 10)" "$(val a.exr R 30 10)" 1e-5
	"$gdlwr" --previous a.exr in.exr b.exr --compression none --stats s.json
	near "$(val b.exr state.frames)" 2 0.1
	[[ " $(names b.exr)" != *" P."* ]]
	near "$(sed 's/.*"meanFrames": \([0-9.e-]*\).*/\1/' s.json)" "$(val b.exr state.frames)" 1e-4
	near "$(sed 's/.*"followed": \([0-9.e-]*\).*/\1/' s.json)" 1 0.05
	awk -v a="$(val a.exr error.R)" -v b="$(val b.exr error.R)" 'BEGIN { exit !(b <= a) }'
	# a frame without a sequence has no state
	"$gdlwr" in.exr out.exr --compression none
	[[ " $(names out.exr)" != *" state."* ]]
}

@test "a previous frame that does not fit is named, with what is wrong" {
	frame in.exr
	"$gdlwr" in.exr without.exr
	refused "without.exr: no channel state.value.R: it holds no state" --previous without.exr in.exr
	"$support/mkexr.pl" small.exr 5 4 R=1 G=1 B=1 P.X='$x' P.Y='$y' P.Z=0
	"$gdlwr" -q --state small.exr state.exr
	refused "state.exr: 5 x 4 pixels, expected 40 x 30" --previous state.exr in.exr
	refused "nowhere.exr: No such file or directory" --previous nowhere.exr in.exr
	run -2 --separate-stderr bash -c "'$gdlwr' --previous - -o out.exr <in.exr"
	[ "$stderr" = "gdlwr: --previous -: standard input is the frame to denoise" ]
}

@test "positions that are no numbers, a state that is none" {
	frame in.exr
	"$support/mkexr.pl" bad.exr 40 30 R=1 G=1 B=1 P.X='$x == 3 ? nan() : $x' P.Y='$y == 4 ? inf() : $y' P.Z=1
	"$gdlwr" -q --state bad.exr a.exr --compression none
	"$gdlwr" -q --previous a.exr bad.exr b.exr --compression none
	near "$(val b.exr R)" 1 1e-4
	state=()
	for c in value.R value.G value.B slope.R slope.G slope.B P.00 P.01 P.11 position.X position.Y position.Z frames; do
		state+=("state.$c=\$x % 2 ? nan() : -1e30")
	done
	"$support/mkexr.pl" rubbish.exr 40 30 "${state[@]}"
	"$gdlwr" -q --previous rubbish.exr in.exr b.exr --compression none --stats s.json
	"$gdlwr" -q in.exr a.exr --compression none
	near "$(val b.exr R)" "$(val a.exr R)" 1e-5
	grep -q '"followed": 0,' s.json
}

@test "real renders: relMSE below what was measured and a tenth" {
	"$gdlwr" "$data/kitchen/path16eq.exr" out.exr
	"${gdlwr%gdlwr}gdrelmse" -r "$data/kitchen/reference.exr" out.exr --max 0.0065	# noisy: 0.0369
}

@test "one pixel, one row, one column" {
	for s in "1 1" "1 9" "9 1" "2 2"; do
		# shellcheck disable=SC2086
		"$support/mkexr.pl" in.exr $s R='1 + $x + $y' G=1 B=1 variance.R=0.01 variance.G=0.01 variance.B=0.01 Z='$x' \
			P.X='$x' P.Y='$y' P.Z=1
		for o in "" --paper --dense --state; do
			# shellcheck disable=SC2086
			"$gdlwr" -q $o in.exr out.exr --compression none
			near "$(val out.exr G)" 1 0.05
		done
	done
}

@test "the manual lists the options in the order of -h" {
	"$gdlwr" -h | sed -nE 's/^  (-[a-zA-Z], |    )--([a-z0-9-]+).*/\2/p' >help
	sed -nE 's/^\.It (.*[ ,])?-([a-z-]{2,}).*/\2/p' "$top/man/gdlwr.1" >manual
	diff help manual
}
