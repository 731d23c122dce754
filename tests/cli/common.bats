#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause
# What all tools have in common.

setup() {
	bats_require_minimum_version 1.5.0
	top=$BATS_TEST_DIRNAME/../..
	bin=$(realpath "${GD_BIN:-$top/bin}")
	support=$(realpath "$top/tests/support")
	man=$(realpath "$top/man")
	cd "$BATS_TEST_TMPDIR"
}

tools() { (cd "$bin" && ls gd*) | grep -v '\.so$'; }

# Filters that need no more than one input; the ones that need an operand are left out.
small() { "$support/mkexr.pl" "${1:-in.exr}" 5 4 R='$x' G='$y' B=1 Z='$x+$y'; }

options_of_help() {
	"$bin/$1" -h | sed -nE 's/^  (-([a-zA-Z]), |    )--([a-z0-9-]+).*/\2 \3/p' | tr ' ' '\n' | grep . | sort -u
}

# ".It Fl o Ar file , Fl -output Ar file" and ".It Fl v , -verbose"
options_of_manual() {
	awk '/^\.It Fl/ { for (i = 3; i <= NF; i++)
		if ($(i - 1) == "Fl" || ($(i - 1) == "," && $i ~ /^-/)) { sub(/^-/, "", $i); print $i } }' "$man/$1.1" |
		sort -u
}

@test "-h goes to standard output and names the tool" {
	for t in $(tools); do
		run --separate-stderr "$bin/$t" -h
		[ "$status" -eq 0 ]
		[ -z "$stderr" ]
		[[ "${lines[0]}" == "usage: $t "* ]]
		run --separate-stderr "$bin/$t" --version
		[ "$status" -eq 0 ]
		[[ "$output" == "$t "[0-9]* ]]
	done
}

@test "every option of -h is in the manual, and the other way round" {
	for t in $(tools); do
		[ -f "$man/$t.1" ] || { echo "no man/$t.1"; return 1; }
		diff <(options_of_help "$t") <(options_of_manual "$t") || { echo "$t: help < > manual"; return 1; }
	done
}

@test "an unknown option is named, exit 2, standard output empty" {
	for t in $(tools); do
		run --separate-stderr "$bin/$t" --no-such-thing in.exr
		[ "$status" -eq 2 ]
		[ -z "$output" ]
		[ "$stderr" = "$t: unknown option --no-such-thing ($t -h lists the options)" ]
	done
}

@test "a number out of range is named with its option" {
	for t in $(tools); do
		run --separate-stderr "$bin/$t" -j 0 in.exr
		[ "$status" -eq 2 ]
		[ "$stderr" = "$t: option -j: 0 is not in 1 to 1024 ($t -h lists the options)" ]
	done
}

@test "a missing input takes one line and exit 2, and leaves nothing behind" {
	mkdir empty
	cd empty
	for t in $(tools); do
		run --separate-stderr bash -c "'$bin/$t' nowhere.exr nowhere2.exr -o out 2>&1 >/dev/null </dev/null"
		[ "$status" -eq 2 ]
		[ "${#lines[@]}" -eq 1 ] || { echo "$t: $output"; return 1; }
		[[ "$output" == "$t: "* ]]
		[ -z "$(ls)" ]
	done
}

@test "a full standard output is an error" {
	for t in $(tools); do
		run bash -c "'$bin/$t' -h 2>&1 >/dev/full"
		[ "$status" -eq 2 ]
		[ "$output" = "$t: standard output: No space left on device" ]
	done
}

@test "a closed standard output is an error, and no file takes its place" {
	small
	run bash -c "'$bin/gdmerge' in.exr 2>&1 >&-"
	[ "$status" -eq 2 ]
	[ "${#lines[@]}" -eq 1 ]
	run bash -c "'$bin/gdmerge' in.exr -o out.exr >&- 2>err"
	[ "$status" -eq 0 ]
	[ -s out.exr ]
}

@test "a full disk is an error" {
	small
	run --separate-stderr "$bin/gdmerge" in.exr -o /dev/full
	[ "$status" -eq 2 ]
	[ "${#stderr_lines[@]}" -eq 1 ]
	[[ "$stderr" == "gdmerge: "*"No space left on device"* ]]
}

@test "a reader that leaves ends a tool quietly" {
	"$support/mkexr.pl" big.exr 600 400 R=1 G=1 B=1
	run bash -c "{ '$bin/gdmerge' big.exr; echo \$? >status; } 2>err | head -c 10 >/dev/null"
	[ "$(cat status)" -eq 2 ]
	[ ! -s err ]
}

@test "no EXR to a terminal, none from one" {
	command -v script >/dev/null || skip "no script(1)"
	small
	run script -qec "'$bin/gdmerge' in.exr" /dev/null
	[ "$status" -eq 2 ]
	[[ "$output" == "gdmerge: no output: standard output is a terminal"* ]]
	run script -qec "'$bin/gdmerge' -o out.exr" /dev/null
	[ "$status" -eq 2 ]
	[[ "$output" == "gdmerge: no input: standard input is a terminal"* ]]
	[ ! -e out.exr ]
}

@test "files and pipes behave alike" {
	small
	export SOURCE_DATE_EPOCH=0
	"$bin/gdmerge" in.exr -o a.exr --compression none
	"$bin/gdmerge" <in.exr >b.exr
	cat in.exr | "$bin/gdmerge" - | cat >c.exr
	[ "$(wc -c <a.exr)" -gt 100 ]
	cmp b.exr c.exr || [ "$("$support/exrval.pl" b.exr R)" = "$("$support/exrval.pl" c.exr R)" ]
	[ "$("$support/exrval.pl" a.exr Z 3 2)" = 5 ]
	[ "$("$support/exrval.pl" c.exr Z 3 2)" = 5 ]
}

@test "the history grows a line a tool, with seconds beside it" {
	small
	"$bin/gdmerge" in.exr -q | "$bin/gdmerge" --map "Z=Z" -o out.exr --compression none
	run "$support/exrval.pl" out.exr @gd:history
	[ "${lines[0]}" = "gdmerge in.exr -q" ]
	[ "${lines[1]}" = "gdmerge --map Z=Z -o out.exr --compression none" ]
	run "$support/exrval.pl" out.exr @gd:seconds.gdmerge
	[ "$status" -eq 0 ]
}

@test "the same command gives the same file, whatever the threads" {
	small
	export SOURCE_DATE_EPOCH=0
	for n in 1 2 7; do OMP_NUM_THREADS=$n "$bin/gdmerge" in.exr in.exr --spp 2 >$n.exr; done
	cmp 1.exr 2.exr
	cmp 1.exr 7.exr
}

@test "--stats is one JSON object, written whole" {
	small
	"$bin/gdmerge" in.exr -o out.exr --stats s.json
	run cat s.json
	[ "${#lines[@]}" -eq 1 ]
	[[ "$output" == '{"tool": "gdmerge", '*'"inputs": 1, '*'"status": 0, "seconds": '*', "io_seconds": '*'}' ]]
	if command -v python3 >/dev/null; then python3 -m json.tool s.json >/dev/null; fi
	run ! "$bin/gdmerge" nowhere.exr -o out.exr --stats s.json
	[[ "$(cat s.json)" == *'"status": 2, "error": "nowhere.exr: No such file or directory"'* ]]
	run --separate-stderr "$bin/gdmerge" in.exr -o out.exr --stats "no/such/s.json"
	[ "$status" -eq 2 ]
	[[ "$stderr" == "gdmerge: no/such/s.json: "* ]]
	rm out.exr
	run --separate-stderr "$bin/gdmerge" in.exr -o out.exr --stats out.exr
	[ "$status" -eq 2 ]
	[[ "$stderr" == "gdmerge: option --stats: out.exr is the image"* ]]
	[ ! -e out.exr ]
}

@test "a failure takes one line, whatever else fails" {
	small
	run --separate-stderr "$bin/gdmerge" nowhere.exr -o out.exr --stats no/such/s.json
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdmerge: nowhere.exr: No such file or directory" ]
	run --separate-stderr "$bin/gdmerge" in.exr -o ""
	[ "$status" -eq 2 ]
	[ "$stderr" = "gdmerge: the output has an empty name" ]
}

@test "an output that is the input" {
	small
	"$bin/gdmerge" in.exr in.exr --spp 1 -o in.exr --compression none
	[ "$("$support/exrval.pl" in.exr samples 0 0)" = 2 ]
	[ "$(ls)" = in.exr ]
}

@test "starting takes no more than it must" {
	for t in $(tools); do
		if ldd "$bin/$t" | grep -qE 'libasan|libubsan'; then skip "the sanitizers bring their own libraries"; fi
		[ "$t" != gdrender ] || continue	# Embree and assimp are C++
		run bash -c "ldd '$bin/$t' | grep -cE 'OpenImageIO|OpenColorIO|stdc'"
		[ "$output" -eq 0 ]
	done
}
