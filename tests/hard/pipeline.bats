#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause
# Hostile buffers through every tool of the pipeline: a clear refusal, or finite numbers.
bats_require_minimum_version 1.5.0

setup() {
	root=$(cd "$BATS_TEST_DIRNAME/../.." && pwd)
	support=${GD_SUPPORT:-$root/build/opt/tests/support}
	PATH=${GD_BIN:-$root/bin}:$support:$PATH
	export SOURCE_DATE_EPOCH=0
	cd "$BATS_TEST_TMPDIR"
}

# run_one NAME COMMAND...: the command ends with 0 and finite values in NAME.exr, in the channels that are its
# own (others pass as they are), or with 2, one line and no file. MISS=1: it may miss its tolerance and say 1.
run_one() {
	local name=$1 status=0 own
	shift
	case $1 in
	gdmerge) own=. ;;
	gdsolve) own='^[RGB]$' ;;
	gdbag | gdfeature) own='(^|half[01].)feature' ;;
	gdapr | gdlwr) own='^[RGB]$|^error|^model|^state' ;;
	esac
	rm -f "$name.exr"
	"$@" -q --compression none -o "$name.exr" 2>stderr || status=$?
	if [ "$status" -eq 0 ] || [ "$status" -eq "${MISS:-0}" ]; then
		gdcheck -c "$own" "$name.exr" || { echo "$*"; return 1; }
	elif [ "$status" -ne 2 ] || [ "$(wc -l <stderr)" -ne 1 ] || [ -e "$name.exr" ]; then
		echo "$*: status $status, $(wc -l <stderr) lines: $(head -3 stderr)"
		return 1
	else
		echo "refused: $*: $(cat stderr)"
		return 3
	fi
}

# Every tool on in.exr; none may refuse.
pipeline() {
	local m
	run_one merged gdmerge in.exr in.exr
	for m in ols wls l2 l1; do run_one $m gdsolve -m $m in.exr; done
	run_one bag gdbag in.exr
	run_one feature gdfeature in.exr
	run_one clean gdapr feature.exr
	run_one paper gdapr --paper feature.exr
	run_one plain gdapr in.exr
	for m in "" --dense --paper; do
		# shellcheck disable=SC2086
		run_one linear gdlwr $m feature.exr
	done
	run_one plain gdlwr in.exr
}

@test "sizes from 1x1 to primes" {
	for size in "1 1" "2 1" "1 2" "1 23" "23 1" "2 2" "3 5" "13 11" "31 17"; do
		# shellcheck disable=SC2086
		mkgd in.exr $size
		pipeline
	done
}

@test "all black, negative, denormal" {
	for c in black negative denormal; do
		mkgd in.exr 13 11 $c
		pipeline
	done
}

@test "a firefly of 1e30 in colour, in one bin, in a gradient" {
	for c in firefly firefly-bin firefly-dx; do
		mkgd in.exr 17 13 $c
		pipeline
	done
}

@test "NaN in every kind of channel" {
	for c in nan nan-colour nan-dx nan-bin nan-variance nan-albedo all-nan; do
		mkgd in.exr 17 13 $c
		pipeline
	done
}

@test "Inf in every kind of channel" {
	for c in inf inf-variance inf-n; do
		mkgd in.exr 17 13 $c
		pipeline
	done
}

@test "variances: all zero, zero in stripes, over 24 orders" {
	for c in zero-variance striped-variance; do
		mkgd in.exr 17 13 $c
		pipeline
	done
	mkgd in.exr 17 13 wide-variance
	MISS=1 pipeline
}

@test "all gradients zero" {
	mkgd in.exr 17 13 flat
	pipeline
}

@test "features: constant, collinear, masks, offset by 1e8" {
	for c in constant-albedo constant-features collinear-features offset-z wide-offset masks; do
		mkgd in.exr 17 13 $c
		pipeline
	done
}

@test "two bins, and half floats" {
	mkgd in.exr 17 13 bins=2
	pipeline
	mkgd in.exr 17 13 type=half
	pipeline
	mkgd in.exr 17 13 type=half scale=1e6
	pipeline
}

@test "one bin, or none: what cannot be made is refused, the rest works" {
	for n in 0 1; do
		mkgd in.exr 17 13 bins=$n
		for m in ols l2 l1; do run_one $m gdsolve -m $m in.exr; done
		run_one clean gdapr in.exr
		run_one paper gdapr --paper in.exr
		run_one linear gdlwr in.exr
		run_one linear gdlwr --paper in.exr
		for tool in gdbag gdfeature; do
			code=0
			run_one out $tool in.exr || code=$?
			[ $code -eq 0 ] || [ $code -eq 3 ]
		done
	done
}

@test "missing channels are named in one line, or not missed" {
	mkgd in.exr 9 7 drop=dx
	for tool in "gdsolve -m l1" "gdsolve -m ols"; do
		# shellcheck disable=SC2086
		run -2 --separate-stderr $tool in.exr -o out.exr
		[ -z "$output" ]
		[ "${#stderr_lines[@]}" -eq 1 ]
		[[ $stderr == "${tool%% *}: in.exr: "*dx* ]]
		[ ! -e out.exr ]
	done
	mkgd in.exr 9 7 drop=G
	for tool in gdapr gdlwr "gdsolve -m l2"; do
		# shellcheck disable=SC2086
		run -2 --separate-stderr $tool in.exr -o out.exr
		[ -z "$output" ]
		[ "${#stderr_lines[@]}" -eq 1 ]
		[[ $stderr == "${tool%% *}: in.exr: "*"channel"*G* ]]
	done
	mkgd in.exr 9 7 drop=albedo drop=N drop=Z drop=dx drop=dy drop=bin
	run_one clean gdapr in.exr
	run_one clean gdlwr in.exr
	mkgd in.exr 9 7 drop=albedo drop=N drop=Z drop=dx drop=dy drop=bin drop=variance
	run_one clean gdapr in.exr
	run_one clean gdlwr in.exr
}

@test "a scaled input gives the scaled output" {
	# powers of two are exact, so only what is not proportional shows
	mkgd a.exr 23 19
	for scale in 1024 0.0009765625; do
		mkgd b.exr 23 19 scale=$scale
		for m in ols wls l2 l1; do
			run_one a1 gdsolve -m $m a.exr
			run_one b1 gdsolve -m $m b.exr
			gdcheck a1.exr b1.exr 1e-3 $scale || { echo "gdsolve -m $m, scale $scale"; return 1; }
		done
		for tool in "gdapr --paper" gdapr gdlwr "gdlwr --dense" "gdlwr --paper"; do
			# shellcheck disable=SC2086
			for f in a b; do
				run_one ${f}1 $tool $f.exr
				gdfeature $f.exr -o ${f}f.exr
				run_one ${f}2 $tool ${f}f.exr
			done
			gdcheck a1.exr b1.exr 2e-3 $scale || { echo "$tool, scale $scale"; return 1; }
			gdcheck a2.exr b2.exr 2e-3 $scale || { echo "gdfeature | $tool, scale $scale"; return 1; }
		done
	done
}

@test "mirrored and transposed input gives the mirrored and transposed solution" {
	mkgd a.exr 23 19
	for turn in x y t; do
		if [ $turn = t ]; then mkgd b.exr 19 23 turn=t; else mkgd b.exr 23 19 turn=$turn; fi
		for m in ols wls l2 l1; do
			gdsolve --tolerance 1e-7 -m $m a.exr -o a1.exr
			gdsolve --tolerance 1e-7 -m $m b.exr -o b1.exr
			gdcheck a1.exr b1.exr 1e-3 1 $turn || { echo "gdsolve -m $m, turned $turn"; return 1; }
		done
	done
}

@test "1, 2 and 7 threads: the same bytes" {
	mkgd in.exr 67 41
	gdfeature in.exr -o feature.exr
	for tool in "gdsolve -m l1 in.exr" "gdsolve -m wls in.exr" "gdbag in.exr" "gdfeature in.exr" "gdapr feature.exr" \
			"gdapr --paper feature.exr" "gdapr in.exr" "gdmerge in.exr in.exr" "gdlwr feature.exr" "gdlwr in.exr" \
			"gdlwr --dense feature.exr" "gdlwr --paper feature.exr"; do
		for j in 1 2 7; do
			# shellcheck disable=SC2086
			$tool -j $j -o out.exr
			# the history tells the number of threads: the pixels alone are compared
			perl "$root/tests/support/pixels.pl" out.exr >$j.raw
		done
		cmp 1.raw 2.raw && cmp 1.raw 7.raw || { echo "$tool"; return 1; }
	done
}

@test "a full device is named, a closed pipe is no news" {
	mkgd in.exr 67 41
	gdfeature in.exr -o feature.exr
	for tool in "gdmerge in.exr" "gdsolve in.exr" "gdbag in.exr" "gdfeature in.exr" "gdapr feature.exr" "gdlwr feature.exr"; do
		# shellcheck disable=SC2086
		run -2 --separate-stderr $tool -o /dev/full
		[ "${#stderr_lines[@]}" -eq 1 ]
		[[ $stderr == "${tool%% *}: "*"No space left on device"* ]]
		run -2 --separate-stderr bash -c "$tool >/dev/full"
		[ "${#stderr_lines[@]}" -eq 1 ]
		[[ $stderr == "${tool%% *}: "*"No space left on device"* ]]
		run --separate-stderr bash -c "$tool | true"
		[ -z "$stderr" ]
	done
}

@test "an output that is an input" {
	for tool in gdmerge gdsolve gdbag gdfeature gdapr gdlwr; do
		mkgd in.exr 23 19
		$tool in.exr -o want.exr
		$tool in.exr -o in.exr
		perl "$root/tests/support/pixels.pl" in.exr >a.raw
		perl "$root/tests/support/pixels.pl" want.exr >b.raw
		cmp a.raw b.raw
	done
	[ "$(find . -name '*.exr*' | wc -l)" -eq 2 ]	# nothing temporary is left
}

@test "a cut pipe, an empty one, rubbish: one line, exit 2, nothing left" {
	mkgd in.exr 23 19
	head -c 3000 in.exr >cut.exr
	: >empty.exr
	head -c 5000 "$root/tests/run" >text.exr
	for tool in gdmerge gdsolve gdbag gdfeature gdapr gdlwr; do
		for f in cut empty text; do
			run -2 --separate-stderr bash -c "cat $f.exr | $tool -o out.exr"
			[ -z "$output" ]
			[ "${#stderr_lines[@]}" -eq 1 ]
			[ ! -e out.exr ]
			run -2 --separate-stderr $tool $f.exr -o out.exr
			[ "${#stderr_lines[@]}" -eq 1 ]
			[ ! -e out.exr ]
		done
	done
	[ "$(find . -name '*.exr*' | wc -l)" -eq 4 ]
}

@test "sequences of hostile frames" {
	mkgd good.exr 17 13 position=1
	run_one before gdlwr --state good.exr
	for c in black negative denormal firefly nan all-nan inf inf-variance zero-variance offset-z; do
		mkgd in.exr 17 13 position=1 $c
		for m in "" --paper; do
			# shellcheck disable=SC2086
			run_one state gdlwr $m --state in.exr
			run_one after gdlwr $m --previous state.exr good.exr
			run_one after gdlwr $m --previous before.exr in.exr
		done
		run_one clean gdapr in.exr --neighbours good.exr
		cp in.exr twin.exr
		run_one clean gdapr good.exr --neighbours in.exr twin.exr
	done
	for size in "1 1" "1 23" "23 1" "3 5"; do
		# shellcheck disable=SC2086
		mkgd in.exr $size position=1
		run_one state gdlwr --state in.exr
		run_one after gdlwr --previous state.exr in.exr
		cp in.exr twin.exr
		run_one clean gdapr in.exr --neighbours twin.exr
	done
	mkgd in.exr 67 41 position=1
	cp in.exr twin.exr
	cp in.exr third.exr
	for j in 1 2 7; do
		gdlwr --state -j $j in.exr -o state.exr
		gdlwr --previous state.exr -j $j in.exr -o out.exr
		perl "$root/tests/support/pixels.pl" out.exr >$j.raw
		gdapr -j $j in.exr -o out.exr --neighbours twin.exr third.exr
		perl "$root/tests/support/pixels.pl" out.exr >>$j.raw
	done
	cmp 1.raw 2.raw
	cmp 1.raw 7.raw
}

@test "damaged files: refused in one line, or finite numbers; as another frame, too" {
	mkgd good.exr 17 13 position=1
	for f in "${GD_TESTDATA:-$root/testdata}"/damaged/*; do
		for tool in "gdlwr" "gdapr good.exr --neighbours"; do
			code=0
			# shellcheck disable=SC2086
			run_one out $tool "$f" >said || code=$?
			[ $code -eq 0 ] || [ $code -eq 3 ] || { cat said; return 1; }
		done
	done
}

@test "gdrelmse counts what is not finite and never hides it" {
	mkgd ref.exr 17 13
	mkgd nan.exr 17 13 nan inf
	gdrelmse --format tsv nan.exr ref.exr >table
	awk -F'\t' 'NR == 1 { for (i = 1; i <= NF; i++) c[$i] = i } NR == 2 { n = $c["nonfinite"] } END { exit n != 2 }' table
}
