#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause

setup() {
	bats_require_minimum_version 1.5.0
	top=$BATS_TEST_DIRNAME/../..
	bin=$(realpath "${GD_BIN:-$top/bin}")
	gdsample=$bin/gdsample
	support=$(realpath "$top/tests/support")
	cd "$BATS_TEST_TMPDIR"
}

val() { "$support/exrval.pl" "$@"; }
names() { "$support/exrval.pl" "$1" | sed 's/:.*//' | sort | tr '\n' ' '; }

# Clean on the left, noisy on the right; 8 samples.
frame() {
	"$support/mkexr.pl" "${1:-in.exr}" 40 30 R=0.5 G=0.25 B='0.5 + $x / 80' \
		error.R='$x < 20 ? 1e-5 : 1e-2' error.G=1e-5 error.B=1e-5 samples=8 A='$x / 40' \
		model.spread=0.1 light.R='$y' "${@:2}"
}

# The mean of the map times the pixels.
sum() { awk -v m="$(val "$1" sampling)" 'BEGIN { printf "%.0f", m * 1200 }'; }

@test "the map goes beside what was there, and its sum is the budget" {
	frame
	run --separate-stderr "$gdsample" --spp 4 in.exr out.exr --compression none
	[ "$status" -eq 0 ]
	[ -z "$output" ]
	[ -z "$stderr" ]
	[ "$(names out.exr)" = "$(names in.exr | sed 's/samples /samples sampling /')" ]
	[ "$(sum out.exr)" = 4800 ]
	for c in R G B error.R samples A model.spread light.R; do
		[ "$(val out.exr $c 21 7)" = "$(val in.exr $c 21 7)" ]
	done
	awk -v a="$(val out.exr sampling 5 5)" -v b="$(val out.exr sampling 33 20)" 'BEGIN { exit !(a <= 1 && b >= 5) }'
	"$gdsample" --total 4801 in.exr out.exr --compression none
	[ "$(sum out.exr)" = 4801 ]
	"$gdsample" --spp 0.25 in.exr out.exr --compression none
	[ "$(sum out.exr)" = 300 ]
}

@test "bounds, the floor and multiples hold" {
	frame
	"$gdsample" --spp 4 --min 2 --max 5 in.exr out.exr --compression none
	[ "$(sum out.exr)" = 4800 ]
	[ "$(val out.exr sampling 5 5)" = 3 ] || [ "$(val out.exr sampling 5 5)" = 2 ]
	[ "$(val out.exr sampling 33 20)" = 5 ]
	"$gdsample" --spp 4 --floor 1 in.exr out.exr --compression none
	[ "$(val out.exr sampling 5 5)" = 4 ]
	[ "$(val out.exr sampling 33 20)" = 4 ]
	"$gdsample" --spp 4 --multiple 8 in.exr out.exr --compression none
	[ "$(sum out.exr)" = 4800 ]
	for x in 3 19 24 31; do [ $(($(val out.exr sampling $x 9) % 8)) -eq 0 ]; done
}

@test "a budget is needed, one, and one that can be spent" {
	frame
	run --separate-stderr "$gdsample" in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: no budget: give --spp or --total" ]
	run --separate-stderr "$gdsample" --spp 1 --total 9 in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: --spp and --total are two budgets: give one" ]
	run --separate-stderr "$gdsample" --spp 7 --max 6 in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: 8400 samples are more than 6 for each of 1200 pixels" ]
	run --separate-stderr "$gdsample" --spp 2 --min 3 in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: 2400 samples are less than 3 for each of 1200 pixels" ]
	run --separate-stderr "$gdsample" --spp 2 --min 3 --max 2 in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: --min 3 is above --max 2" ]
	run --separate-stderr "$gdsample" --total 10.5 in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: --total 10.5: expected a multiple of 1" ]
	run --separate-stderr "$gdsample" --spp 2 --multiple 5000 in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: --spp 2: rounded to a multiple of 5000, no sample in all 40 x 30 pixels" ]
	run --separate-stderr "$gdsample" --spp 2 --floor -0.5 in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: --floor -0.5: expected 0 to 1, or -1" ]
	run --separate-stderr "$gdsample" --spp 2 --blur -0.5 in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: --blur -0.5: expected 0 to 10, or -1" ]
	[ ! -e out.exr ]
}

@test "a missing channel is named" {
	"$support/mkexr.pl" in.exr 4 3 R=1 G=1 B=1
	run --separate-stderr "$gdsample" --spp 1 in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: in.exr: no channel error.R" ]
	"$support/mkexr.pl" in.exr 4 3 R=1 G=1 error.R=1 error.G=1 error.B=1
	run --separate-stderr "$gdsample" --spp 1 in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: in.exr: no channel B" ]
}

@test "samples come from the channel, an attribute, an option, or are taken for 1" {
	frame one.exr samples='$y < 15 ? 64 : 4'
	"$gdsample" --spp 4 one.exr out.exr --compression none
	awk -v a="$(val out.exr sampling 33 5)" -v b="$(val out.exr sampling 33 20)" 'BEGIN { exit !(a < b) }'
	"$gdsample" --spp 4 --samples 8 one.exr even.exr --compression none
	awk -v a="$(val even.exr sampling 33 5)" -v b="$(val even.exr sampling 33 20)" 'BEGIN { d = a - b; exit !(d * d <= 1) }'
	"$support/mkexr.pl" bare.exr 6 5 R=1 G=1 B=1 error.R='$x' error.G=1 error.B=1
	run --separate-stderr "$gdsample" --spp 4 bare.exr out.exr
	[ "$status" -eq 0 ]
	[[ "$stderr" == "gdsample: warning: the file does not say how many samples"* ]]
	run --separate-stderr "$gdsample" --spp 4 --samples 2 bare.exr out.exr
	[ "$status" -eq 0 ]
	[ -z "$stderr" ]
	"$support/mkexr.pl" said.exr 6 5 -a gd:samplesPerPixel=8 R=1 G=1 B=1 error.R='$x' error.G=1 error.B=1
	run --separate-stderr "$gdsample" --spp 4 -v said.exr out.exr
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"8 samples a pixel so far"* ]]
}

@test "no error anywhere: even, and told" {
	frame in.exr error.R=0 error.G=0 error.B=0
	run --separate-stderr "$gdsample" --spp 3 in.exr out.exr --compression none
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"no error anywhere: the map is even"* ]]
	[ "$(val out.exr sampling 5 5)" = 3 ]
	[ "$(val out.exr sampling 33 20)" = 3 ]
}

@test "NaN, Inf and fireflies do not take the budget; one pixel is enough" {
	frame in.exr error.G='$x == 3 && $y == 4 ? nan() : $x == 30 && $y == 9 ? inf() : 1e-5' \
		R='$x == 8 && $y == 8 ? 1e30 : $x == 9 && $y == 9 ? nan() : 0.5'
	run --separate-stderr "$gdsample" --spp 4 in.exr out.exr --compression none
	[ "$status" -eq 0 ]
	[ "$(sum out.exr)" = 4800 ]
	awk -v a="$(val out.exr sampling 30 9)" 'BEGIN { exit !(a > 4 && a < 2000) }'
	"$support/mkexr.pl" dot.exr 1 1 R=1 G=1 B=1 error.R=1 error.G=1 error.B=1 samples=4
	"$gdsample" --total 12345 dot.exr out.exr --compression none
	[ "$(val out.exr sampling 0 0)" = 12345 ]
}

@test "seeds differ, threads do not, the published rule does" {
	frame
	export SOURCE_DATE_EPOCH=0
	for n in 1 2 7; do OMP_NUM_THREADS=$n "$gdsample" --spp 1.5 in.exr >$n.exr; done
	cmp 1.exr 2.exr
	cmp 1.exr 7.exr
	"$gdsample" --spp 1.5 -s 2 in.exr s.exr --compression none
	"$gdsample" --spp 1.5 --paper in.exr p.exr --compression none
	for f in s p; do
		differ=0
		for x in 5 11 17 23 29 35; do for y in 2 9 16 23; do
			[ "$(val 1.exr sampling $x $y)" = "$(val $f.exr sampling $x $y)" ] || differ=1
		done; done
		[ $differ -eq 1 ]
		[ "$(sum $f.exr)" = 1800 ]
	done
}

@test "-v and --stats tell what is expected" {
	frame
	run --separate-stderr "$gdsample" --spp 4 -v --stats s.json in.exr out.exr
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"4800 samples, "*"mean relative error "*" should become "*" with an even map"* ]]
	[[ "$(cat s.json)" == *'"total": 4800'*'"relative_error": '*'"expected": '*'"expected_even": '* ]]
	sed -E 's/.*"expected": ([^,]*), "expected_even": ([^,}]*).*/\1 \2/' s.json | awk '{ exit !($1 < $2) }'
}

@test "--png shows the map" {
	[ -f "$bin/gd-plugin.so" ] || skip "no plug-in"
	frame
	"$gdsample" --spp 4 --png map.png in.exr out.exr
	[ "$(head -c 4 map.png | od -An -tx1 | tr -d ' ')" = 89504e47 ]
	run --separate-stderr "$gdsample" --spp 4 --png map.exr in.exr out2.exr
	[ "$status" -eq 2 ]
	[[ "$stderr" == "gdsample: --png: map.exr: "* ]]
	run --separate-stderr bash -c "'$gdsample' --spp 4 --png - in.exr | wc -c; exit \${PIPESTATUS[0]}"
	[ "$status" -eq 2 ]
	[ "$output" -eq 0 ]
	[ "$stderr" = "gdsample: --png -: the output of the map itself" ]
	[ ! -e out2.exr ]
}

@test "a map of before is replaced" {
	frame in.exr sampling=77
	"$gdsample" --spp 4 in.exr out.exr --compression none
	[ "$(sum out.exr)" = 4800 ]
	[ "$(names out.exr | tr ' ' '\n' | grep -c '^sampling$')" -eq 1 ]
}

# The loop on a real render, pass by pass: two bins, a map, a second pass by it, both merged. all.exr: what one
# render of these counts would have written.
loop() {
	export PATH=${GD_SUPPORT:-$top/build/opt/tests/support}:$PATH
	data=${GD_TESTDATA:-$top/testdata}/kitchen
	gdspend "$data/path16eq.exr" first.exr 2
	"$bin/gdapr" --fast -q first.exr clean.exr
	"$gdsample" -q --spp 3 --max 6 "$@" clean.exr map.exr
	gdspend -p "$data/path16eq.exr" second.exr 2 map.exr
	gdspend "$data/path16eq.exr" all.exr 2 map.exr
}

relmse() { "$bin/gdrelmse" -q --format tsv -r "$data/reference.exr" "$1" | tail -n 1 | cut -f2; }

@test "two passes merge to what one render would have been, and pay" {
	loop --multiple 2
	run --separate-stderr "$bin/gdmerge" first.exr second.exr -o merged.exr
	[ "$status" -eq 0 ]
	[ -z "$stderr" ]
	gdcheck all.exr merged.exr 1e-5
	"$bin/gdapr" --fast -q merged.exr merged-clean.exr
	gdspend "$data/path16eq.exr" even.exr 2 3
	"$bin/gdapr" --fast -q even.exr even-clean.exr
	awk -v a="$(relmse merged-clean.exr)" -v b="$(relmse even-clean.exr)" 'BEGIN { print a, b; exit !(a < 0.95 * b) }'
}

@test "halves of unlike counts keep their counts" {
	loop
	"$bin/gdmerge" first.exr second.exr -o merged.exr --compression none
	gdcheck all.exr merged.exr 1e-5
	differ=0
	for x in 5 30 55 80 105; do for y in 9 33 66 90; do
		for c in half0.samples half1.samples half0.R bin1.G; do
			awk -v a="$(val merged.exr $c $x $y)" -v b="$(val all.exr $c $x $y)" \
				'BEGIN { exit !(a <= b * 1.00001 && b <= a * 1.00001) }'
		done
		[ "$(val merged.exr half0.samples $x $y)" = "$(val merged.exr half1.samples $x $y)" ] || differ=1
	done; done
	[ $differ -eq 1 ]
}

@test "passes in one piece: told, and denoised without fault" {
	loop
	for f in first second; do gdcut $f.exr $f-whole.exr 0 0 112 96 bin half; done
	run --separate-stderr "$bin/gdmerge" first-whole.exr second-whole.exr -o merged.exr
	[ "$status" -eq 0 ]
	[[ "$stderr" == *"pixels have samples in the even or the odd bins only: render every pass in two parts"* ]]
	"$bin/gdmerge" -q --bins 0 first-whole.exr second-whole.exr -o binless.exr
	for f in merged binless; do
		"$bin/gdapr" -q $f.exr $f-clean.exr
		gdcheck -c "^(R|G|B|error.*)\$" $f-clean.exr
	done
}

@test "--gradients: shares where they pay, none of before, and what is expected" {
	data=${GD_TESTDATA:-$top/testdata}/kitchen
	export PATH=${GD_SUPPORT:-$top/build/opt/tests/support}:$PATH
	"$bin/gdfeature" -q "$data/gpt16.exr" | "$bin/gdapr" --fast -q >clean.exr
	"$gdsample" --spp 8 --gradients "$data/gpt16.exr" --gradient-cost 1.3 --stats s.json clean.exr map.exr --compression none
	gdcheck -c "^(gradients|sampling)\$" map.exr
	[ "$(names map.exr | tr ' ' '\n' | grep -c '^gradients$')" -eq 1 ]
	sed -E 's/.*"gradients": ([^,]*), .*"gradients_gain": ([^,]*), "gradients_everywhere": ([^,]*), "cost": ([^,}]*).*/\1 \2 \3 \4/' s.json |
		awk -v n=$((112 * 96 * 8)) '{ print; exit !($1 > 0.02 && $1 < 0.98 && $2 < 1.01 && $2 < 1.05 * $3 && $4 > 0.998 * n && $4 < 1.002 * n) }'
	awk -v m="$(val map.exr sampling)" 'BEGIN { exit !(m > 6.1 && m < 8) }'
	"$gdsample" --spp 8 --gradients "$data/gpt16.exr" --gradient-cost 100 clean.exr dear.exr --compression none
	[ "$(val dear.exr gradients)" = 0 ]
	"$gdsample" --spp 8 map.exr without.exr --compression none
	[ "$(names without.exr | tr ' ' '\n' | grep -c '^gradients$')" -eq 0 ]
}

@test "--gradients: what does not fit is named" {
	frame
	run --separate-stderr "$gdsample" --spp 4 --gradients in.exr in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: in.exr: 0 bins of the colour, at least 4 are needed" ]
	run --separate-stderr "$gdsample" --spp 4 --gradients none.exr in.exr out.exr
	[ "$status" -eq 2 ]
	[[ "$stderr" == "gdsample: none.exr: "* ]]
	run --separate-stderr bash -c "'$gdsample' --spp 4 --gradients - <in.exr >out.exr"
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: --gradients -: standard input is the denoised image" ]
	data=${GD_TESTDATA:-$top/testdata}/kitchen
	run --separate-stderr "$gdsample" --spp 4 --gradients "$data/gpt16.exr" in.exr out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdsample: $data/gpt16.exr: is 112x96, expected 40x30" ]
	run --separate-stderr "$gdsample" --spp 4 --gradients in.exr --gradient-cost 0.5 in.exr out.exr
	[ "$status" -eq 2 ]
}
