#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause
# examples/adaptive.sh: what it refuses, and passes of a tiny image.

setup() {
	bats_require_minimum_version 1.5.0
	top=$(realpath "$BATS_TEST_DIRNAME/../..")
	bin=$(realpath "${GD_BIN:-$top/bin}")
	adaptive=$top/examples/adaptive.sh
	export PATH=$bin:$PATH
	cd "$BATS_TEST_TMPDIR"
	scene=$top/testdata/scenes/door.gltf
}

need_renderer() { [ -x "$bin/gdrender" ] || skip "no gdrender"; }
spp() { perl "$top/tests/support/exrval.pl" "$1" samples 2>/dev/null || perl "$top/tests/support/exrval.pl" "$1" @gd:samplesPerPixel; }

@test "usage, and what is refused" {
	run --separate-stderr "$adaptive" -h
	[ "$status" -eq 0 ]
	[[ "$output" == "usage: adaptive.sh [options] scene.gltf clean.exr"* ]]
	run --separate-stderr "$adaptive" one.gltf
	[ "$status" -eq 2 ]
	[[ "$stderr" == "usage: "* ]]
	run --separate-stderr "$adaptive" -p 0 one.gltf out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "adaptive.sh: -p 0: expected 1 to 99" ]
	run --separate-stderr "$adaptive" -g some one.gltf out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "adaptive.sh: -g some: expected a share from 0 to 1, all, none or auto" ]
	run --separate-stderr "$adaptive" -g 1.5 one.gltf out.exr
	[ "$status" -eq 2 ]
	run --separate-stderr "$adaptive" -c 0.5 one.gltf out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "adaptive.sh: -c 0.5: expected a number from 1" ]
	run --separate-stderr "$adaptive" -d gdbag one.gltf out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "adaptive.sh: -d gdbag: expected gdapr or gdlwr" ]
	mkdir none
	for t in gdmerge gdfeature gdapr gdsample; do ln -s "$bin/$t" none/; done
	run --separate-stderr env PATH="$PWD/none:/usr/bin:/bin" "$adaptive" one.gltf out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "adaptive.sh: gdrender: not found; is it built, and its directory in PATH?" ]
	need_renderer
	run --separate-stderr "$adaptive" one.gltf out.exr
	[ "$status" -eq 2 ]
	[ "$stderr" = "adaptive.sh: one.gltf: cannot be read" ]
}

@test "passes cost what was asked for, and nothing is left behind" {
	need_renderer
	mkdir tmp
	for how in "-g none" "-g all" "-g 0.0" "-g auto" "" "-u" "-d gdlwr"; do
		# shellcheck disable=SC2086
		run --separate-stderr env TMPDIR="$PWD/tmp" "$adaptive" -q -n 16 -p 2 $how "$scene" out.exr -- --size 48x36
		echo "$how: $stderr"
		[ "$status" -eq 0 ]
		[ -z "$stderr" ]
		[ -s out.exr ]
		rm out.exr
		[ -z "$(ls tmp)" ]
	done
	"$adaptive" -q -g 0.5 -c 2.2 -p 1 -f 32 -k half "$scene" out.exr -- --size 16x12
	awk -v n="$(spp half/pass1.exr)" 'BEGIN { exit n != 20 }'
	"$adaptive" -q -g none -n 6 -f 4 -p 3 -k kept "$scene" out.exr -- --size 48x36
	gdmerge -q kept/pass1.exr kept/pass2.exr kept/pass3.exr -o all.exr --compression none
	awk -v n="$(spp all.exr)" 'BEGIN { exit !(n > 15.99 && n < 16.01) }'
}

@test "passes that are kept are not rendered again, and give the same image" {
	need_renderer
	export SOURCE_DATE_EPOCH=0
	"$adaptive" -q -n 8 -p 2 -k kept "$scene" one.exr -- --size 32x24
	cp -p kept/pass2.exr was.exr
	"$adaptive" -q -n 8 -p 2 -k kept "$scene" two.exr -- --size 32x24
	[ ! kept/pass2.exr -nt was.exr ]
	gdrelmse -q -r one.exr --max 1e-12 two.exr
}
