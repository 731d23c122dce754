#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause
# The scenes of testdata/scenes are what their generator writes, and gdrender takes them.

setup() {
	bats_require_minimum_version 1.5.0
	top=$BATS_TEST_DIRNAME/../..
	bin=$(realpath "${GD_BIN:-$top/bin}")
	scenes=$(realpath "${GD_TESTDATA:-$top/testdata}/scenes")
	cd "$BATS_TEST_TMPDIR"
}

mkscenes() { "${GD_SUPPORT:-$top/build/opt/tests/support}/mkscenes" "$@"; }

@test "the scenes are what mkscenes writes, bit by bit" {
	mkdir new
	mkscenes new
	diff -r new "$scenes"
}

@test "mkscenes says where it cannot write" {
	run --separate-stderr mkscenes nowhere
	[ "$status" -eq 2 ]
	[ -z "$output" ]
	[[ "$stderr" == nowhere/*": No such file or directory" ]]
	run --separate-stderr mkscenes
	[ "$status" -eq 2 ]
	[ "$stderr" = "usage: mkscenes FOLDER" ]
}

@test "all scenes together stay small, and each has its options and a line in SOURCES" {
	[ "$(cat "$scenes"/* | gzip -9 | wc -c)" -lt 2000000 ]
	for f in "$scenes"/*.gltf; do
		name=$(basename "$f" .gltf)
		[ "$(wc -l <"$scenes/$name.args")" -eq 1 ]
		grep -q "^		${name%%[0-9]*}	" "$scenes/../SOURCES" || { echo "SOURCES: no $name"; return 1; }
	done
}

@test "gdrender takes every scene and leaves nothing out" {
	[ -x "$bin/gdrender" ] || skip "no gdrender"
	for f in "$scenes"/*.gltf; do
		# shellcheck disable=SC2046
		run --separate-stderr "$bin/gdrender" -v $(cat "${f%.gltf}.args") --spp 1 --size 16x12 --bins 0 \
			"$f" out.exr
		[ "$status" -eq 0 ] || { echo "$f: $stderr"; return 1; }
		if grep -v "gd-plugin.so is not installed" <<<"$stderr" | grep "left out"; then return 1; fi
	done
}

@test "references.sh goes on where it was stopped, and starts again when something is another" {
	[ -x "$bin/gdrender" ] || skip "no gdrender"
	export REF_SIZE=16x12 REF_SPP=2 REF_PASSES=3
	references() { run "$top/tests/references.sh" "$bin" "$scenes" out caustic; }
	references
	[ "$status" -eq 0 ]
	[ "${#lines[@]}" -eq 3 ]
	[ "$(cmp out/caustic.part0.exr out/caustic.part1.exr 2>&1)" != "" ]
	cp out/caustic.exr first.exr
	rm out/caustic.part1.exr
	references
	[ "$status" -eq 0 ]
	[ "$output" = "caustic: part 2 of 3, 2 samples a pixel" ]
	"$bin/gdrelmse" --plain --max 0 first.exr out/caustic.exr
	"$bin/gdrelmse" out/caustic.part0.exr out/caustic.exr | grep -q "two halves"
	references
	[ "$status" -eq 0 ]
	[ -z "$output" ]
	REF_PASSES=4 references
	[ "$status" -eq 0 ]
	[ "$output" = "caustic: part 4 of 4, 2 samples a pixel" ]
	REF_SPP=3 references
	[ "$status" -eq 0 ]
	[ "${#lines[@]}" -eq 3 ]
	run "$top/tests/references.sh" "$bin" "$scenes" out nowhere
	[ "$status" -eq 2 ]
}
