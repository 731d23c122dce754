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
	[ "$status" -eq 2 ] && [ -z "$output" ]
	[[ "$stderr" == nowhere/*": No such file or directory" ]]
	run --separate-stderr mkscenes
	[ "$status" -eq 2 ] && [ "$stderr" = "usage: mkscenes FOLDER" ]
}

@test "all scenes together stay small, and each has its options and a line in SOURCES" {
	[ "$(cat "$scenes"/* | gzip -9 | wc -c)" -lt 2000000 ]
	for f in "$scenes"/*.gltf; do
		name=$(basename "$f" .gltf)
		[ "$(wc -l <"$scenes/$name.args")" -eq 1 ]
		grep -q "^		${name%%[0-9]*}	" "$scenes/../SOURCES" || { echo "SOURCES: no $name"; return 1; }
	done
}

@test "gdrender takes every scene without a note" {
	[ -x "$bin/gdrender" ] || skip "no gdrender"
	for f in "$scenes"/*.gltf; do
		# shellcheck disable=SC2046
		(cd "$scenes" && run --separate-stderr "$bin/gdrender" $(cat "${f%.gltf}.args") --spp 1 \
			--size 16x12 --bins 0 "$f" "$BATS_TEST_TMPDIR/out.exr"
		[ "$status" -eq 0 ] && [ -z "$stderr" ] || { echo "$f: $stderr"; exit 1; })
	done
}
