#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause

setup() {
	bats_require_minimum_version 1.5.0
	top=$BATS_TEST_DIRNAME/../..
	bin=$(realpath "${GD_BIN:-$top/bin}")
	gdrender=$bin/gdrender
	[ -x "$gdrender" ] || skip "gdrender is not built: no Embree here"
	support=$(realpath "$top/tests/support")
	data=$(realpath "${GD_TESTDATA:-$top/testdata}")
	scene=$data/scenes/door.gltf
	cd "$BATS_TEST_TMPDIR"
}

val() { "$support/exrval.pl" "$@"; }
names() { "$support/exrval.pl" "$1" | sed 's/:.*//' | sort | tr '\n' ' '; }
near() { awk -v a="$1" -v b="$2" -v e="${3:-1e-5}" 'BEGIN { d = a - b; s = b < 0 ? -b : b; exit !((d < 0 ? -d : d) <= e * (s + 1e-12)) }'; }
# A small render, uncompressed.
small() { "$gdrender" -q --size 24x18 --compression none "$scene" "$@"; }

@test "a buffer with everything in it" {
	run --separate-stderr "$gdrender" --size 24x18 --spp 8 --compression none "$scene" out.exr
	[ "$status" -eq 0 ]
	[ -z "$output" ]
	for c in R G B variance.R dx.G dy.B dx.variance.R dy.variance.B albedo.R N.X P.Y Z bin0.R bin7.G \
		bin7.dx.B bin3.dy.R; do
		val out.exr | grep -q "^$c:float" || { echo "no $c"; return 1; }
	done
	[ "$(val out.exr @gd:samplesPerPixel)" = 8 ]
	[ "$(val out.exr @gd:bins)" = 8 ]
	[ "$(val out.exr @gd:history)" = "gdrender --size 24x18 --spp 8 --compression none $scene out.exr" ]
	val out.exr @gd:renderSeconds
	val out.exr @gd:seconds.gdrender
	awk -v r="$(val out.exr R)" 'BEGIN { exit !(r > 0) }'
	[ "$(val out.exr dx.R 23 4)" = 0 ]
	[ "$(val out.exr dy.R 4 17)" = 0 ]
	# the mean of the bins is the mean
	near "$(for b in 0 1 2 3 4 5 6 7; do val out.exr bin$b.G 9 9; done | awk '{ s += $1 / 8 } END { printf "%.9g", s }')" \
		"$(val out.exr G 9 9)"
	if names out.exr | grep -q samples; then return 1; fi
}

@test "the same seed, the same bytes, on any number of threads; another seed, others" {
	export SOURCE_DATE_EPOCH=0
	for j in 1 2 3; do small --spp 3 -j $j -o - >$j.exr; done
	"$support/pixels.pl" 1.exr >1.raw
	for j in 2 3; do "$support/pixels.pl" $j.exr | cmp 1.raw -; done
	small --spp 3 -j 2 -o - >again.exr
	cmp 2.exr again.exr
	small --spp 3 --seed 2 -o 4.exr
	run ! cmp -s 1.exr 4.exr
}

@test "a crop is a part of the whole" {
	small --spp 4 -o whole.exr
	small --spp 4 --crop 5,15,3,-6 -o part.exr
	for c in R bin2.G dx.B variance.B Z; do
		[ "$(val part.exr $c 2 3)" = "$(val whole.exr $c 7 6)" ] || { echo $c; return 1; }
	done
	[ "$(val part.exr dx.R 9 2)" = 0 ]
	run --separate-stderr small --crop 5,30,3,6 -o no.exr
	[ "$status" -eq 2 ]
	[ ! -e no.exr ]
	[ "$stderr" = 'gdrender: crop "5,30,3,6" is not inside the 24x18 pixels' ]
}

@test "no gradients, no bins, few or many" {
	small --spp 4 --gradients 0 --bins 0 -o plain.exr
	if names plain.exr | grep -E "dx|dy|bin"; then return 1; fi
	small --spp 8 --bins 4 -o four.exr
	names four.exr | grep -q "bin3.R"
	if names four.exr | grep "bin4"; then return 1; fi
	small --spp 1 -o one.exr
	if names one.exr | grep -E "variance|bin"; then return 1; fi
	small --spp 3 -o three.exr
	names three.exr | grep -q "bin2.R"
	if names three.exr | grep "bin3.R"; then return 1; fi
	# half of the samples trace offset paths: gradients are worth less than the samples say
	small --spp 8 --bins 4 --gradients 0.5 -o half.exr
	[ "$(val half.exr dx.samples 3 3)" = 4 ]
	[ "$(val half.exr R 3 3)" = "$(val four.exr R 3 3)" ]
}

@test "a sampling map: counts, holes, and the size of the image" {
	"$support/mkexr.pl" map.exr 24 18 sampling='$x % 4' gradients='$y < 9'
	"$gdrender" -q "$scene" --sampling map.exr --gradients map.exr -o out.exr --compression none
	for x in 0 1 2 3; do [ "$(val out.exr samples $x 5)" = $x ]; done
	[ "$(val out.exr R 4 5)" = 0 ]
	[ "$(val out.exr albedo.R 4 5)" = 0 ]
	[ "$(val out.exr half1.samples 1 0)" = 0 ]
	[ "$(val out.exr half0.samples 3 0)" = 2 ]
	[ "$(val out.exr dx.samples 1 12)" = 0 ]	# a difference of colours
	near "$(val out.exr dx.samples 1 4)" 1.3333333
	cat map.exr | "$gdrender" -q "$scene" --sampling - --gradients - -o pipe.exr --compression none
	cmp <("$support/pixels.pl" out.exr) <("$support/pixels.pl" pipe.exr)
	"$gdrender" -q "$scene" --sampling map.exr --crop 4,12,6,10 -o part.exr --compression none
	[ "$(val part.exr samples 3 2)" = 3 ]
}

@test "maps that do not fit are named with what was found and wanted" {
	"$support/mkexr.pl" small.exr 20 18 sampling=1 gradients=1
	"$support/mkexr.pl" bad.exr 24 18 sampling='$x == 3 && $y == 2 ? nan() : 1' gradients='$x == 5 ? -1 : 1'
	"$support/mkexr.pl" part.exr 24 18 sampling=1.5 gradients=1.5
	"$support/mkexr.pl" other.exr 24 18 R=1
	try() { run --separate-stderr small -o out.exr "${@:2}"; [ "$status" -eq 2 ] && [ "$stderr" = "gdrender: $1" ] &&
		[ ! -e out.exr ] || { echo "$stderr"; return 1; }; }
	try "small.exr: sampling is 20 x 18, expected 24 x 18" --sampling small.exr
	try "small.exr: gradients is 20 x 18, expected 24 x 18" --gradients small.exr
	try "bad.exr: sampling is nan at (3, 2), expected a whole number, 0 to 16777216" --sampling bad.exr
	try "bad.exr: gradients is -1 at (5, 0), expected 0 to 1" --gradients bad.exr
	try "part.exr: sampling is 1.5 at (0, 0), expected a whole number, 0 to 16777216" --sampling part.exr
	try "part.exr: gradients is 1.5 at (0, 0), expected 0 to 1" --gradients part.exr
	try "other.exr: no channel sampling" --sampling other.exr
	try "nowhere.exr: No such file or directory" --sampling nowhere.exr
	try "--spp and --sampling both tell the samples: give one" --sampling small.exr --spp 4
}

@test "options that cannot be" {
	try() { run --separate-stderr "$gdrender" "$scene" -o out.exr "${@:2}"; [ "$status" -eq 2 ] &&
		[[ "$stderr" == "gdrender: $1"* ]] && [ ! -e out.exr ] || { echo "$stderr"; return 1; }; }
	try '--size "24" is not WIDTHxHEIGHT' --size 24
	try '--size 0x4: expected sides of 1 to 65536' --size 0x4
	try '--gradients 1.5: expected 0 to 1, or a map' --gradients 1.5
	try '--bins 1: expected 0, or 2 to 64' --bins 1
	try 'option --bins: 65 is not in 0 to 64' --bins 65
	try '--sky "1,2" is neither a number nor R,G,B' --sky 1,2
	for s in -1 1e38 1e39 nan 1,2e30,3; do try "--sky $s: expected radiance from 0 to 1e+30" --sky $s; done
	try '--environment and --sky are two skies: give one' --environment a.exr --sky 1
	try '--pairs tells where gradients are, and --gradients 0 takes none' --pairs a.exr --gradients 0
	try '--focus without an --aperture changes nothing' --focus 2
	try 'out of memory: 65536 x 65536 pixels' --size 65536x65536
	run --separate-stderr "$gdrender" - -o out.exr </dev/null
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdrender: a scene is not read from standard input: name its file" ]
	run --separate-stderr "$gdrender" nowhere.gltf -o out.exr
	[ "$status" -eq 2 ]
	[[ "$stderr" == "gdrender: nowhere.gltf: "* ]]
	[ ! -e out.exr ]
	run --separate-stderr "$gdrender"
	[ "$status" -eq 2 ]
	[[ "$stderr" == "gdrender: missing operand: "* ]]
}

@test "a limit of time" {
	small --time 1 -o out.exr --stats s.json
	awk -v s="$(sed 's/.*"render_seconds": \([^,]*\).*/\1/' s.json)" 'BEGIN { exit !(s < 3) }'
	awk -v n="$(val out.exr @gd:samplesPerPixel)" 'BEGIN { exit !(n >= 1 && n == int(n)) }'
	small --time 100 --spp 2 -o out.exr
	[ "$(val out.exr @gd:samplesPerPixel)" = 2 ]
	"$support/mkexr.pl" map.exr 24 18 sampling='1 + $x % 2'
	"$gdrender" -q "$scene" --sampling map.exr --time 1 -o out.exr --compression none
	awk -v a="$(val out.exr samples 0 0)" -v b="$(val out.exr samples 1 0)" 'BEGIN { exit !(a >= 1 && b == 2 * a) }'
}

@test "two passes are merged to their mean" {
	small --spp 8 -o a.exr
	small --spp 8 --seed 2 -o b.exr
	"$bin/gdmerge" a.exr b.exr -o both.exr --compression none
	for c in R dx.G bin5.B bin2.dy.R albedo.G; do
		near "$(val both.exr $c 11 7)" "$(echo "$(val a.exr $c 11 7) $(val b.exr $c 11 7)" | awk '{ printf "%.9g", ($1 + $2) / 2 }')" ||
			{ echo $c; return 1; }
	done
	[ "$(val both.exr samples 3 3)" = 16 ]
	if names both.exr | grep -q dx.samples; then return 1; fi
}

@test "on through the chain, and back with a map" {
	run -0 --separate-stderr bash -o pipefail -c "'$gdrender' -q --size 24x18 --spp 8 '$scene' | '$bin/gdfeature' |
		'$bin/gdapr' -q -o clean.exr"
	small --spp 8 -o first.exr
	"$bin/gdsample" -q --spp 4 --multiple 2 --gradients first.exr clean.exr -o map.exr
	"$gdrender" -q "$scene" --sampling map.exr --gradients map.exr --seed 2 -o second.exr
	run -0 --separate-stderr bash -o pipefail -c "'$bin/gdmerge' -q first.exr second.exr | '$bin/gdfeature' -q |
		'$bin/gdapr' -q -o clean2.exr --compression none"
	[ "$(names clean2.exr | tr ' ' '\n' | grep -cE '^(dx|dy|bin)')" = 0 ]
	awk -v m="$(val clean2.exr @gd:samplesPerPixel)" 'BEGIN { exit !(m > 8.5 && m < 12.1) }'
}

@test "pairs, from features and from a first pass" {
	small --spp 8 -o first.exr
	small --spp 4 --pairs first.exr -o pairs.exr
	names pairs.exr | grep -q "pair0.R pair0.variance.B"
	if names pairs.exr | grep -q "dx.R"; then return 1; fi
	small --spp 4 --pairs pairs.exr --seed 2 -o more.exr
	for c in x y; do [ "$(val more.exr pair0.$c 9 9)" = "$(val pairs.exr pair0.$c 9 9)" ]; done
	"$bin/gdmerge" -q pairs.exr more.exr -o both.exr --compression none
	[ "$(val both.exr pair0.y 9 9)" = "$(val pairs.exr pair0.y 9 9)" ]
	names both.exr | grep -q "bin3.pair0.G"
	# least squares keep the mean: differences have none, whatever their noise
	"$bin/gdsolve" -q --pairs -m l2 both.exr -o solved.exr --compression none
	awk -v a="$(val solved.exr G)" -v b="$(val both.exr G)" 'BEGIN { exit !(a > 0.99 * b && a < 1.01 * b) }'
}

@test "an interrupted render leaves no file" {
	timeout -s INT 1 "$gdrender" -q --size 640x480 --spp 10000 "$scene" -o out.exr || status=$?
	[ "$status" -ne 0 ]
	[ -z "$(ls)" ]
}

@test "what is left out of a scene is told by default, in one line, and not with -q" {
	sed 's/"images": .*/"images": [],/; s/^{"pbrMetallicRoughness"/{"alphaMode": "MASK", "pbrMetallicRoughness"/' "$scene" >bare.gltf
	cp "${scene%.gltf}.bin" .
	run --separate-stderr "$gdrender" --size 8x6 --spp 1 bare.gltf out.exr
	echo "$stderr"
	[ "$status" -eq 0 ]
	[ "$(grep -c "^gdrender: warning: bare.gltf: .*left out" <<<"$stderr")" -ge 2 ]
	[[ "$stderr" == *"warning: bare.gltf: not modelled and left out: alpha"* ]]
	[ "${#stderr_lines[@]}" -le 3 ]
	run --separate-stderr "$gdrender" -q --size 8x6 --spp 1 bare.gltf out.exr
	[ "$status" -eq 0 ]
	[ -z "$stderr" ]
}

@test "ambient light for the gradients does not get into the colour" {
	run --separate-stderr small --spp 2 --ambient 0.5 --reuse-offsets -o no.exr
	[ "$status" -eq 2 ]
	[ ! -e no.exr ]
	[[ "$stderr" == "gdrender: ambient light is for the gradients alone: "* ]]
}

@test "a map without any sample: a pass that merging takes nothing of" {
	"$support/mkexr.pl" none.exr 24 18 sampling=0
	small --spp 4 -o first.exr
	small --sampling none.exr --seed 2 -o second.exr
	[ "$(val second.exr samples 3 3)" = 0 ]
	"$bin/gdmerge" -q first.exr second.exr -o both.exr
	"$bin/gdrelmse" -q -r first.exr --plain --max 0 both.exr
}

@test "--stats and -v" {
	run --separate-stderr "$gdrender" -v --size 24x18 --spp 2 "$scene" -o out.exr --stats s.json
	[[ "$stderr" == *"gdrender: 24 x 18 pixels, 2 samples a pixel, "* ]]
	for k in width height samples load_seconds render_seconds cpu_seconds samples_per_second; do
		grep -q "\"$k\": [0-9]" s.json || { echo $k; return 1; }
	done
}
