#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause

setup() {
	bats_require_minimum_version 1.5.0
	top=$BATS_TEST_DIRNAME/../..
	bin=$(realpath "${GD_BIN:-$top/bin}")
	support=$(realpath "$top/tests/support")
	val=$support/exrval.pl
	cd "$BATS_TEST_TMPDIR"
}

# An edge and a ramp with noise, as COUNT bins of colour and gradients and their means.
# $1 file, $2 bins, $3 width, $4 height, further arguments go to mkexr.pl
buffer() {
	local out=$1 bins=$2 w=$3 h=$4 f='($x>$w/2?2:0.5)+$y/$h' sd=0.05 args=() b c
	shift 4
	for c in R G B; do
		for ((b = 0; b < bins; b++)); do
			args+=("bin$b.$c=$f+4*$sd*noise()")
			args+=("bin$b.dx.$c=\$x==\$w-1?0:(\$x==int(\$w/2)?1.5:0)+$sd*noise()")
			args+=("bin$b.dy.$c=\$y==\$h-1?0:1/\$h+$sd*noise()")
		done
		args+=("$c=$f" "dx.$c=\$x==int(\$w/2)&&\$x<\$w-1?1.5:0" "dy.$c=\$y==\$h-1?0:1/\$h")
		args+=("dx.variance.$c=1e-3" "dy.variance.$c=1e-3")
	done
	"$support/mkexr.pl" "$out" "$w" "$h" "${args[@]}" "$@"
}

channels() { "$val" "$1" | sed 's/:.*//' | sort; }
layer() { for c in R G B; do echo "$1$c"; done; }

calc() { awk "BEGIN { printf \"%.9g\", $* }"; }

# near VALUE WANTED TOLERANCE
near() { awk -v a="$1" -v b="$2" -v t="$3" 'BEGIN { d = a - b; exit !(d <= t && -d <= t) }' || { echo "$1, expected $2"; return 1; }; }

@test "feature, halves and variances come, gradients go" {
	buffer in.exr 4 24 16 'Z=$x' "cam era.id=7"
	"$bin/gdfeature" --compression none in.exr out.exr
	diff <(channels out.exr) <({
		layer ""
		for b in 0 1 2 3; do layer "bin$b."; done
		for l in feature half0.feature half1.feature half0 half1; do layer "$l."; layer "$l.variance."; done
		echo Z; echo "cam era.id"
	} | sort)
}

@test "the feature has the image's mean and its edge" {
	buffer in.exr 8 32 24
	"$bin/gdfeature" --compression none in.exr out.exr
	near "$("$val" out.exr feature.G)" "$("$val" in.exr G)" 1e-4
	left=$("$val" out.exr feature.R 15 12)
	right=$("$val" out.exr feature.R 18 12)
	near "$(calc "$right - $left")" 1.5 0.1
}

@test "--keep keeps the gradients" {
	buffer in.exr 2 12 9
	"$bin/gdfeature" --keep --compression none in.exr out.exr
	for l in dx. dy. dx.variance. bin0.dx. bin1.dy.; do
		[ "$("$val" out.exr "${l}R" 6 3)" = "$("$val" in.exr "${l}R" 6 3)" ]
	done
}

@test "halves of the colour are means of even and odd bins" {
	buffer in.exr 4 9 7
	"$bin/gdfeature" --compression none in.exr out.exr
	a=$("$val" in.exr bin1.G 4 3)
	b=$("$val" in.exr bin3.G 4 3)
	near "$("$val" out.exr half1.G 4 3)" "$(calc "($a + $b) / 2")" 1e-6
	near "$("$val" out.exr half1.variance.G 4 3)" "$(calc "($a - $b)^2 / 4")" 1e-6
}

@test "without bins one solve, no halves" {
	buffer in.exr 0 20 14
	run -0 --separate-stderr "$bin/gdfeature" -v --compression none in.exr out.exr
	[[ "$stderr" == *"one solve"* ]]
	channels out.exr | grep -qx feature.variance.B
	if channels out.exr | grep -q half; then return 1; fi
	near "$("$val" out.exr feature.R 3 3)" "$("$val" in.exr R 3 3)" 1e-2
}

@test "without bins and variances: equal weights, no filter, and it says so" {
	"$support/mkexr.pl" in.exr 8 6 R='$x+$y' G='$x' B='$y' dx.{R,G}='$x<7' dx.B=0 dy.{R,B}='$y<5' dy.G=0
	run -0 --separate-stderr "$bin/gdfeature" -v --compression none in.exr out.exr
	[[ "$stderr" == *"neither bins nor variances"* ]]
	near "$("$val" out.exr feature.R 5 4)" 9 1e-3
	near "$("$val" out.exr feature.G 0 4)" 0 1e-3
	if channels out.exr | grep -q feature.variance; then return 1; fi
}

@test "halves as they come from a renderer count as two bins" {
	buffer two.exr 2 16 12
	buffer in.exr 0 16 12
	args=()
	for c in R G B; do
		for i in 0 1; do
			for l in "" dx. dy.; do args+=("half$i.$l$c=0.01*noise()"); done
		done
		args+=("$c=0")
	done
	"$support/mkexr.pl" halves.exr 16 12 "${args[@]}"
	"$bin/gdfeature" --compression none halves.exr out.exr
	channels out.exr | grep -qx half1.feature.variance.R
	if channels out.exr | grep -q 'd[xy]\.'; then return 1; fi
	[ "$("$val" out.exr half0.R 3 3)" = "$("$val" halves.exr half0.R 3 3)" ]
}

@test "a missing channel is named" {
	"$support/mkexr.pl" in.exr 4 4 R=1 G=1 B=1
	run -2 --separate-stderr "$bin/gdfeature" in.exr out.exr
	[ "$stderr" = "gdfeature: in.exr: no channel dx.R" ]
	[ ! -e out.exr ]
	"$support/mkexr.pl" in.exr 4 4 R=1 G=1 B=1 dx.{R,G,B}=0 dy.{R,B}=0
	run -2 --separate-stderr "$bin/gdfeature" in.exr out.exr
	[ "$stderr" = "gdfeature: in.exr: no channel dy.G" ]
	run -2 --separate-stderr "$bin/gdfeature" --solve none --filter albedo in.exr out.exr
	[[ "$stderr" == "gdfeature: in.exr: no channel albedo"* ]]
}

@test "--solve none --filter: other layers by their own weights, in place" {
	"$support/mkexr.pl" in.exr 40 30 R=1 G=1 B=1 albedo.{R,G,B}='($x>20)+0.1*noise()' \
		albedo.variance.{R,G,B}=0.01 N.{X,Y,Z}='$x>20' Z='1+0.2*noise()' Z.variance=0.04
	run -0 --separate-stderr "$bin/gdfeature" -v --solve none --filter albedo,N,Z --compression none in.exr out.exr
	[[ "$stderr" == *"N has no variance and no halves"* ]]
	diff <(channels in.exr) <(channels out.exr)
	for x in 5 19 22 35; do
		near "$("$val" out.exr albedo.G $x 15)" "$((x > 20))" 0.1
		[ "$("$val" out.exr N.Y $x 15)" = "$((x > 20))" ]
		near "$("$val" out.exr Z $x 15)" 1 0.1
	done
	awk -v v="$("$val" out.exr albedo.variance.G 10 15)" 'BEGIN { exit !(v > 0 && v < 0.001) }'
}

@test "--filter with halves: each by the other, the layer is their mean" {
	"$support/mkexr.pl" in.exr 40 30 R=1 G=1 B=1 albedo.{R,G,B}=0.5 half{0,1}.albedo.{R,G,B}='($x>20)+0.1*noise()'
	"$bin/gdfeature" --solve none --filter albedo --compression none in.exr out.exr
	a=$("$val" out.exr half0.albedo.G 30 15)
	b=$("$val" out.exr half1.albedo.G 30 15)
	near "$a" 1 0.06
	near "$("$val" out.exr albedo.G 30 15)" "$(calc "($a + $b) / 2")" 1e-6
}

@test "options that take it apart change what they say" {
	buffer in.exr 4 30 20
	export SOURCE_DATE_EPOCH=0
	for o in "" --no-bagging --no-filter "--solve ols" "-s 2" "-B 3" "-k 1" "--patch 1" "--window 2"; do
		"$bin/gdfeature" $o --compression none in.exr - | tail -c +2000 | md5sum
	done | sort | uniq -d > same
	[ ! -s same ]
}

@test "the same bytes from 1, 2 and 7 threads, files and pipes" {
	buffer in.exr 4 200 70 albedo.{R,G,B}='noise()' albedo.variance.{R,G,B}=1
	export SOURCE_DATE_EPOCH=0
	for j in 1 2 7; do
		"$bin/gdfeature" -j $j --filter albedo --compression none in.exr - | tail -c +4000 | md5sum
	done | sort -u > sums
	[ "$(wc -l < sums)" -eq 1 ]
	bash -o pipefail -c "cat in.exr | '$bin/gdfeature' --filter albedo | tail -c +4000 | wc -c"
}

@test "bad values of options" {
	buffer in.exr 2 4 4
	run -2 --separate-stderr "$bin/gdfeature" --solve best in.exr out.exr
	[ "$stderr" = 'gdfeature: --solve: "best" is none of wls, ols, none' ]
	run -2 --separate-stderr "$bin/gdfeature" -B 1 in.exr out.exr
	[[ "$stderr" == "gdfeature: option -B: 1 is not in 2 to 1000"* ]]
	run -2 --separate-stderr "$bin/gdfeature" --filter ,N in.exr out.exr
	[[ "$stderr" == *"an empty or overlong name"* ]]
}

@test "--stats tells what was done" {
	buffer in.exr 4 16 16
	"$bin/gdfeature" --stats s.json in.exr out.exr
	grep -q '"bins": *4' s.json
	grep -q '"replicates": *10' s.json
	grep -q '"halves": *1' s.json
	grep -q '"filter_seconds"' s.json
}

@test "NaN, Inf and 1e30 in every kind of channel: finite out" {
	buffer in.exr 4 20 16
	args=()
	for c in R G B; do
		for b in 0 1 2 3; do
			args+=("bin$b.$c=\$x==3?nan():\$x==5?inf():1" "bin$b.dx.$c=\$y==2?nan():\$y==7&&\$x==7?1e30:0.1*noise()")
			args+=("bin$b.dy.$c=\$x==4?-inf():\$x==9&&\$y==9?-1e30:0.1*noise()")
		done
		args+=("$c=\$x==1?nan():\$x==2&&\$y==2?1e30:1")
	done
	"$support/mkexr.pl" bad.exr 20 16 "${args[@]}"
	"$bin/gdfeature" --compression none bad.exr out.exr
	for l in feature half0.feature half1.feature half0 half1; do
		for c in R B; do
			[[ "$("$val" out.exr $l.$c)" =~ ^-?[0-9] ]]
			[[ "$("$val" out.exr $l.variance.$c)" =~ ^[0-9] ]]
		done
	done
}

@test "sizes from 1x1, and all black" {
	for s in "1 1" "1 9" "9 1" "7 5"; do
		buffer in.exr 4 $s
		"$bin/gdfeature" --compression none in.exr out.exr
		[[ "$("$val" out.exr feature.R)" =~ ^-?[0-9] ]]
	done
	"$support/mkexr.pl" in.exr 12 10 {,dx.,dy.,bin0.,bin1.,bin0.dx.,bin1.dx.,bin0.dy.,bin1.dy.}{R,G,B}=0
	"$bin/gdfeature" --compression none in.exr out.exr
	near "$("$val" out.exr feature.G)" 0 0
	near "$("$val" out.exr half1.feature.variance.G)" 0 0
}

# Where each pixel of a frame looks, the camera having moved SHIFT pixels.
positions() { printf "%s\n" "P.X=0.1*(\$x+$1)" 'P.Y=0.1*$y' "P.Z=20+2*sin(0.2*(\$x+$1))+cos(0.3*\$y)"; }

@test "--neighbours: raw frames and frames made before give the same bytes; operands come first" {
	mapfile -t pos < <(positions 0)
	for i in 0 1 2; do
		buffer "$i.exr" 4 40 30 "${pos[@]}"
		"$bin/gdfeature" --no-filter --compression none "$i.exr" "raw$i.exr"
	done
	export SOURCE_DATE_EPOCH=1
	"$bin/gdfeature" --compression none 0.exr alone.exr
	"$bin/gdfeature" 0.exr a.exr --compression none --stats s.json --neighbours 1.exr 2.exr
	"$bin/gdfeature" --compression none --neighbours raw1.exr raw2.exr -- raw0.exr b.exr
	"$bin/gdfeature" --compression none --neighbours raw2.exr --neighbours raw1.exr -j 1 0.exr c.exr
	for l in feature half0.feature half1.feature.variance; do
		for at in "7 9" "20 15" "33 3"; do
			# shellcheck disable=SC2086
			[ "$("$val" a.exr "$l.G" $at)" = "$("$val" b.exr "$l.G" $at)" ]
			# shellcheck disable=SC2086
			near "$("$val" a.exr "$l.G" $at)" "$("$val" c.exr "$l.G" $at)" 1e-4
		done
	done
	grep -q '"frames": 3' s.json
	run ! cmp -s alone.exr a.exr
}

@test "--neighbours: what is wrong names the file" {
	buffer in.exr 2 12 9
	buffer other.exr 2 12 8
	"$support/mkexr.pl" plain.exr 12 9 R=1 G=1 B=1
	run --separate-stderr "$bin/gdfeature" in.exr out.exr --neighbours other.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdfeature: other.exr: is 12x8, expected 12x9" ]
	run --separate-stderr "$bin/gdfeature" in.exr out.exr --neighbours plain.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdfeature: plain.exr: no channel dx.R" ]
	run --separate-stderr "$bin/gdfeature" in.exr out.exr --neighbours nowhere.exr
	[ "$status" -eq 2 ]
	[[ "$stderr" == "gdfeature: nowhere.exr: "* ]]
	run --separate-stderr "$bin/gdfeature" in.exr out.exr --neighbours in.exr in.exr in.exr in.exr in.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdfeature: --neighbours: 5 files, expected 4 at most" ]
	run --separate-stderr "$bin/gdfeature" in.exr out.exr --no-filter --neighbours in.exr
	[ "$status" -eq 2 ]
	[[ "$stderr" == "gdfeature: --neighbours: only the filter"* ]]
	run --separate-stderr bash -c "'$bin/gdfeature' -o out.exr --neighbours in.exr <in.exr"
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdfeature: --neighbours in.exr: the frame itself" ]
	"$support/mkexr.pl" once.exr 12 9 R=1 G=1 B=1 dx.R=0 dx.G=0 dx.B=0 dy.R=0 dy.G=0 dy.B=0
	cp in.exr too.exr
	run --separate-stderr "$bin/gdfeature" in.exr out.exr --neighbours too.exr once.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdfeature: in.exr: neighbour 2 has neither bins nor variances of its gradients: it cannot be compared" ]
	[ ! -e out.exr ]
}
