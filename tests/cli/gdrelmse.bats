#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause
bats_require_minimum_version 1.5.0

setup() {
	root=$(cd "$BATS_TEST_DIRNAME/../.." && pwd)
	PATH=${GD_BIN:-$root/bin}:$PATH
	cd "$BATS_TEST_TMPDIR"
}

mkexr() { perl "$root/tests/support/mkexr.pl" "$@"; }

# value COLUMN ROW: a field of the TSV in $output
value() {
	awk -F'\t' -v c="$1" -v r="$2" 'NR == 1 { for (i = 1; i <= NF; i++) if ($i == c) k = i } NR == r + 1 { print $k }' <<<"$output"
}

# close FOUND WANTED [RELATIVE]; WANTED is an expression
close() {
	awk -v a="$1" -v t="${3:-1e-6}" "BEGIN { b = $2; d = a - b; if (d < 0) d = -d; m = b < 0 ? -b : b; exit !(a != \"\" && d <= t * m) }" ||
		{ echo "found $1, wanted $2"; return 1; }
}

need_plugin() {
	[ -e "$(dirname "$(command -v gdrelmse)")/gd-plugin.so" ] || skip "no gd-plugin.so"
}

pair() {
	mkexr ref.exr 8 8 R=2 G=2 B=0.5
	mkexr img.exr 8 8 R=3 G=2 B=1 -a gd:seconds.gdfeature=0.5 -a gd:seconds.gdapr=0.25 -a gd:renderSeconds=4
}

@test "relMSE of constants, by hand; the formula and eps are printed" {
	pair
	run -0 --separate-stderr gdrelmse img.exr ref.exr
	[[ $output == *"(x - r)^2 / (r^2 + eps), eps = 0.01"* ]]
	[[ $output == *"over 3 channels of 64 pixels"* ]]
	[ -z "$stderr" ]
	run -0 gdrelmse --format tsv img.exr ref.exr
	close "$(value relmse 1)" "(1 / 4.01 + 0.25 / 0.26) / 3"
	close "$(value mse 1)" "1.25 / 3"
	close "$(value bias 1)" 0.5
	close "$(value bias_percent 1)" "100 / 3"
	[ "$(value eps 1)" = 0.01 ]
	[ "$(value formula 1)" = "(x - r)^2 / (r^2 + eps)" ]
	[ "$(value noise_free 1)" = false ]
	close "$(value seconds 1)" 0.75
	close "$(value render_seconds 1)" 4
}

@test "--form and --eps" {
	pair
	run -0 gdrelmse --format tsv --form half img.exr ref.exr
	close "$(value relmse 1)" "(1 / 4.01 + 0.25 / 0.26) / 6"
	run -0 gdrelmse --format tsv --form '(r+eps)2' --eps 0.5 img.exr ref.exr
	close "$(value relmse 1)" "(1 / 6.25 + 0.25) / 3"
	run -0 gdrelmse --format tsv --form mean --eps 1 img.exr ref.exr
	close "$(value relmse 1)" "1.25 / 3 / 3.25"
	run -0 gdrelmse --format tsv --form lum --eps 1 img.exr ref.exr
	close "$(value relmse 1)" "1.25 / 3 / ((2 * (0.2126 + 0.7152) + 0.0361) ^ 2 + 1)"
	run -2 --separate-stderr gdrelmse --form r2 img.exr ref.exr
	[ -z "$output" ]
	[[ $stderr == gdrelmse:*r2+eps* ]]
	run -2 gdrelmse --eps 0 img.exr ref.exr
}

@test "--trim" {
	mkexr ref.exr 10 10 R=0 G=0 B=0
	mkexr img.exr 10 10 R='10 * ($x + $y == 0)' G=1 B=0
	run -0 gdrelmse --format tsv --eps 1 --trim 0.01 img.exr ref.exr
	[ "$(value trimmed_pixels 1)" = 1 ]
	close "$(value trimmed 1)" "1 / 3"
	close "$(value relmse 1)" "(1 + 1) / 3"
	run -2 gdrelmse --trim 0.7 img.exr ref.exr
}

@test "halves: free of the reference's own noise, and said so; --plain is not" {
	mkexr ref.exr 128 128 R=1 half0.R='1+0.3*noise()' half1.R='1+0.3*noise()' G=1 half0.G='1+0.3*noise()' \
		half1.G='1+0.3*noise()' B=1 half0.B='1+0.3*noise()' half1.B='1+0.3*noise()'
	mkexr img.exr 128 128 R=1.1 G=1.1 B=1.1
	run -0 gdrelmse --format tsv img.exr ref.exr
	close "$(value mse 1)" 0.01 0.2
	[ "$(value noise_free 1)" = true ]
	run -0 gdrelmse img.exr ref.exr
	[[ $output == *"(x - a)(x - b) / (r^2 + eps)"* ]]
	[[ $output == *"free of the reference's own noise"* ]]
	run -0 gdrelmse --plain --format tsv img.exr ref.exr
	close "$(value mse 1)" 0.01 1e-5
}

@test "several images, pipes, --reference" {
	pair
	run -0 gdrelmse --format tsv img.exr ref.exr img.exr ref.exr
	[ "${#lines[@]}" -eq 4 ]
	close "$(value relmse 2)" 0
	[ "$(value relmse 1)" = "$(value relmse 3)" ]
	[ "$(value seconds 2)" = NA ]
	run -0 bash -o pipefail -c 'cat img.exr | gdrelmse --format tsv -r ref.exr -'
	close "$(value mse 1)" "1.25 / 3"
	run -2 --separate-stderr gdrelmse img.exr
	[ "${#stderr_lines[@]}" -eq 1 ]
}

@test "JSON is JSON, with null where there is no number" {
	pair
	run -0 gdrelmse --format json img.exr ref.exr ref.exr
	perl -MJSON::PP -e 1 2>/dev/null || skip "no JSON::PP"
	perl -MJSON::PP -e 'local $/; $j = decode_json(<STDIN>); die unless @{$j->{images}} == 2 && $j->{eps} == 0.01 &&
		!defined $j->{images}[1]{seconds} && $j->{images}[1]{relmse} == 0 && $j->{images}[0]{image} eq "img.exr"' <<<"$output"
}

@test "--max: 1 if it is exceeded, for any image, and for NaN" {
	pair
	run -0 gdrelmse --max 0.41 img.exr ref.exr
	run -1 --separate-stderr gdrelmse --max 0.4 ref.exr img.exr ref.exr
	[[ $output == *img.exr* ]]
	mkexr nan.exr 8 8 R=2 G='$x == 3 && $y == 4 ? nan() : 2' B=0.5
	run -1 --separate-stderr gdrelmse --max 0.41 nan.exr ref.exr
	run -2 gdrelmse --max nought img.exr ref.exr
}

@test "NaN and Inf are counted, reported and not skipped" {
	pair
	mkexr nan.exr 8 8 R='$x == 1 && $y == 1 ? inf() : 2' G='$x == 3 && $y == 4 ? nan() : 2' B=0.5
	run -0 --separate-stderr gdrelmse --format tsv nan.exr ref.exr
	[ "$(value nonfinite 1)" = 2 ]
	[[ $stderr == *"2 pixels with NaN or Inf"* ]]
	close "$(value relmse 1)" "2 * 4 / 4.01 / 192"
	run -0 --separate-stderr gdrelmse --format tsv ref.exr nan.exr
	[ "$(value nonfinite_reference 1)" = 2 ]
	[ "$(value pixels 1)" = 62 ]
	[[ $stderr == *"the reference has NaN or Inf in 2 pixels"* ]]
	mkexr all.exr 8 8 R='nan()' G=0 B=0
	run -2 --separate-stderr gdrelmse ref.exr all.exr
	[ -z "$output" ]
}

@test "--crop" {
	mkexr ref.exr 20 10 R=0 G=0 B=0
	mkexr img.exr 20 10 R='$x' G='$y' B=0
	run -0 gdrelmse --format tsv --crop 3,4,5,6 img.exr ref.exr
	[ "$(value pixels 1)" = 1 ]
	close "$(value mse 1)" "34 / 3"
	run -0 gdrelmse --format tsv --crop 3,-1,5,-1 img.exr ref.exr
	close "$(value mse 1)" "34 / 3"
	run -2 gdrelmse --crop 0,21,0,10 img.exr ref.exr
	run -2 gdrelmse --crop 3,3,0,10 img.exr ref.exr
	run -2 gdrelmse --crop 1,2,3 img.exr ref.exr
}

@test "--mask, with and without a channel" {
	mkexr ref.exr 20 10 R=0 G=0 B=0
	mkexr img.exr 20 10 R='$x < 5 ? 1 : 100' G=0 B=0
	mkexr mask.exr 20 10 R='$x < 5' other='$x >= 5'
	run -0 gdrelmse --format tsv --mask mask.exr img.exr ref.exr
	[ "$(value pixels 1)" = 50 ]
	close "$(value mse 1)" "1 / 3"
	run -0 gdrelmse --format tsv --mask mask.exr:other img.exr ref.exr
	close "$(value mse 1)" "10000 / 3"
	run -2 --separate-stderr gdrelmse --mask mask.exr:none img.exr ref.exr
	[[ $stderr == *none* ]]
	mkexr small.exr 3 3 R=1
	run -2 gdrelmse --mask small.exr img.exr ref.exr
}

@test "sizes and data windows that differ" {
	pair
	mkexr wide.exr 9 8 R=2 G=2 B=0.5
	run -2 --separate-stderr gdrelmse wide.exr ref.exr
	[ "$stderr" = "gdrelmse: wide.exr is 9x8, the reference 8x8" ]
	[ -z "$output" ]
	mkexr moved.exr 8 8 -o 4,6 R=2 G=2 B='$x < 4 && $y < 2 ? 0.5 : 7'
	run -2 --separate-stderr gdrelmse moved.exr ref.exr
	[[ $stderr == *"begins at (4, 6)"* ]]
	run -0 gdrelmse --windows overlap --format tsv moved.exr ref.exr
	[ "$(value pixels 1)" = 8 ]
	close "$(value relmse 1)" 0
	run -0 gdrelmse --windows ignore --format tsv moved.exr ref.exr
	[ "$(value pixels 1)" = 64 ]
	run -2 gdrelmse --windows any moved.exr ref.exr
}

@test "--layer and --reference-layer, scalars too; --channels" {
	mkexr ref.exr 6 6 R=1 G=2 B=3 Z=4
	mkexr img.exr 6 6 R=0 G=0 B=0 feature.R=1 feature.G=2 feature.B=4 Z=5
	run -0 gdrelmse --format tsv --layer Z img.exr ref.exr
	close "$(value mse 1)" 1
	run -0 gdrelmse --format tsv --channels --layer feature --reference-layer colour img.exr ref.exr
	close "$(value relmse.B 1)" "1 / 9.01"
	close "$(value relmse.R 1)" 0
	run -2 --separate-stderr gdrelmse --layer feature img.exr ref.exr
	[[ $stderr == "gdrelmse: ref.exr: no channel feature"* ]]
	run -2 --separate-stderr gdrelmse --reference-layer Z img.exr ref.exr
	[[ $stderr == *"3 channels, the reference has 1"* ]]
}

@test "--rank: does the error layer know" {
	mkexr ref.exr 32 32 R=0 G=0 B=0
	mkexr img.exr 32 32 R='int($x/8)' G='int($y/8)' B=0 error.R='int($x/8)**2' error.G='int($y/8)**2' error.B=0 \
		anti.R='-int($x/8)**2' anti.G='-int($y/8)**2' anti.B=0
	run -0 gdrelmse --format tsv --rank img.exr ref.exr
	close "$(value rank 1)" 1
	close "$(value estimate_ratio 1)" 1
	run -0 gdrelmse --format tsv --rank --error anti --block 4 img.exr ref.exr
	close "$(value rank 1)" -1
	run -2 --separate-stderr gdrelmse --rank ref.exr ref.exr
	[[ $stderr == *"no channel error"* ]]
}

@test "the same output for any number of threads" {
	mkexr ref.exr 61 47 R='exp(3*noise())' G='noise()' B='exp(noise())'
	mkexr img.exr 61 47 -s 2 R='exp(3*noise())' G='noise()' B='exp(noise())' error.R='noise()' error.G=1 error.B=2
	gdrelmse -j 1 --rank img.exr ref.exr >one
	gdrelmse -j 2 --rank img.exr ref.exr >two
	gdrelmse -j 7 --rank img.exr ref.exr >seven
	cmp one two
	cmp one seven
}

@test "-o, a full disk, and what cannot be read" {
	pair
	gdrelmse -o table.tsv --format tsv img.exr ref.exr
	[ "$(wc -l <table.tsv)" -eq 2 ]
	run -2 --separate-stderr gdrelmse -o /dev/full img.exr ref.exr
	[ "${#stderr_lines[@]}" -eq 1 ]
	run -2 --separate-stderr gdrelmse none.exr ref.exr
	[[ $stderr == "gdrelmse: none.exr: "* ]]
	head -c 400 img.exr >cut.exr
	run -2 --separate-stderr gdrelmse cut.exr ref.exr
	[ -z "$output" ]
}

@test "--heatmap does not overwrite an EXR" {
	mkexr one.exr 2 2 R=1 G=1 B=1
	cp one.exr two.exr
	run -2 --separate-stderr gdrelmse --heatmap two.exr one.exr one.exr
	[ "${#stderr_lines[@]}" -eq 1 ]
	cmp one.exr two.exr
}

@test "--heatmap makes a PNG; without the plug-in it says so, and all else works" {
	pair
	run -2 --separate-stderr env GD_PLUGIN_PATH=/nowhere gdrelmse --heatmap map.png img.exr ref.exr
	[[ $stderr == *gd-plugin.so* ]]
	[ ! -e map.png ]
	run -0 env GD_PLUGIN_PATH=/nowhere gdrelmse img.exr ref.exr
	need_plugin
	run -0 gdrelmse --heatmap map.png img.exr ref.exr
	[ "$(head -c 4 map.png | tail -c 3)" = PNG ]
}
