#!/usr/bin/env bats
# SPDX-License-Identifier: BSD-3-Clause
# Pictures are judged by gdrelmse, which reads a PNG back as linear values.
bats_require_minimum_version 1.5.0

setup() {
	root=$(cd "$BATS_TEST_DIRNAME/../.." && pwd)
	PATH=${GD_BIN:-$root/bin}:$PATH
	unset OCIO
	cd "$BATS_TEST_TMPDIR"
	[ "$BATS_TEST_DESCRIPTION" = "without the plug-in" ] || [ -e "$(dirname "$(command -v gdshow)")/gd-plugin.so" ] ||
		skip "no gd-plugin.so"
}

mkexr() { perl "$root/tests/support/mkexr.pl" "$@"; }

# size PNG: "WIDTH HEIGHT BITS" of its header
size() {
	perl -e 'open F, "<:raw", $ARGV[0]; read F, $h, 25; @v = unpack "x16 N N C", $h; print "@v\n"' "$1"
}

# same PNG EXR: equal but for the steps of 8 bits
same() {
	gdrelmse --form r2+eps --eps 1 --max "${3:-1e-5}" "$1" "$2"
}

ramp() {
	mkexr ramp.exr 16 8 R='$x/15' G='$y/7' B=0.2 Z='1+$x' N.X='$x < 8 ? 1 : -1' N.Y=0 N.Z=0 \
		dx.R='$x-8' dx.G='$x-8' dx.B='$x-8' variance.R='$x**2' variance.G='$x**2' variance.B='$x**2'
}

@test "without the plug-in" {
	ramp
	run -2 --separate-stderr env GD_PLUGIN_PATH=/nowhere gdshow ramp.exr out.png
	[[ $stderr == "gdshow: "*gd-plugin.so* ]]
	[ "${#stderr_lines[@]}" -eq 1 ]
	[ ! -e out.png ]
}

@test "colour through the sRGB display: a PNG that reads back as the image" {
	ramp
	run -0 gdshow ramp.exr out.png
	[ "$(size out.png)" = "16 8 8" ]
	same out.png ramp.exr
	run -0 gdshow --bits 16 ramp.exr -o deep.png
	[ "$(size deep.png)" = "16 8 16" ]
	same deep.png ramp.exr 1e-8
	run -2 gdshow --bits 12 ramp.exr out.png
}

@test "from a pipe, to a pipe, the same bytes" {
	ramp
	gdshow ramp.exr a.png
	cat ramp.exr | gdshow >b.png
	cat ramp.exr | gdshow - c.png
	gdshow -j 7 ramp.exr -o d.png
	cmp a.png b.png
	cmp a.png c.png
	cmp a.png d.png
}

@test "--exposure" {
	ramp
	mkexr dark.exr 16 8 R='$x/60' G='$y/28' B=0.05
	run -0 gdshow -e 2 dark.exr out.png
	same out.png ramp.exr
	run -0 gdshow --exposure -2 ramp.exr out.png
	same out.png dark.exr
	run -2 gdshow -e x ramp.exr out.png
}

@test "--view and --display; \$OCIO is obeyed, a bad one refused" {
	ramp
	run -0 gdshow --view Raw ramp.exr raw.png
	mkexr decoded.exr 16 8 R='linear($x/15)' G='linear($y/7)' B='linear(0.2)'
	same raw.png decoded.exr
	run -0 gdshow --display sRGB --view Standard ramp.exr out.png
	same out.png ramp.exr
	run -2 --separate-stderr gdshow --view Film ramp.exr out2.png
	[[ $stderr == *'"Standard", "Raw"'* ]]
	[ ! -e out2.png ]
	run -2 gdshow --display CRT ramp.exr out2.png
	run -2 --separate-stderr env OCIO=/nowhere/config.ocio gdshow ramp.exr out2.png
	[[ $stderr == *"/nowhere/config.ocio"* ]]
	[ "${#stderr_lines[@]}" -eq 1 ]
}

@test "scalars: percentiles by default, said with -v; --range; brighter is more" {
	ramp
	run -0 --separate-stderr gdshow -v -l Z ramp.exr out.png
	[[ $stderr == *"layer Z: scalar, 1 to 16 (percentiles of the first image)"* ]]
	run -0 --separate-stderr gdshow -v -l Z --range 0,20 ramp.exr out.png
	[[ $stderr == *"0 to 20 (--range)"* ]]
	mkexr black.exr 16 8 R=0 G=0 B=0
	left=$(gdrelmse --crop 0,1,0,8 --format tsv out.png black.exr | awk -F'\t' 'NR == 2 { print $4 }')
	right=$(gdrelmse --crop 15,16,0,8 --format tsv out.png black.exr | awk -F'\t' 'NR == 2 { print $4 }')
	awk -v a="$left" -v b="$right" 'BEGIN { exit !(b > 10 * a) }'
	run -2 gdshow -l Z --range 3,3 ramp.exr out.png
	run -2 gdshow -l Z --range 3 ramp.exr out.png
}

@test "variances on a square-root scale, gradients signed, normals shifted, --as and --scale" {
	ramp
	run -0 --separate-stderr gdshow -v -l variance ramp.exr out.png
	[[ $stderr == *"variance: scalar"*"square-root"* ]]
	run -0 --separate-stderr gdshow -v -l dx ramp.exr out.png
	[[ $stderr == *"dx: signed, -8 to 8"* ]]
	run -0 --separate-stderr gdshow -v -l dx --as scalar --scale log ramp.exr out.png
	[[ $stderr == *"dx: scalar"*"logarithmic"* ]]
	run -0 gdshow -l N ramp.exr normal.png
	mkexr normal.exr 16 8 R='$x < 8 ? 1 : 0' G=0.2140 B=0.2140
	same normal.png normal.exr 1e-4
	run -2 gdshow -l Z --as normal ramp.exr out2.png
	run -2 gdshow --as pretty ramp.exr out2.png
	run -2 gdshow --scale cubic ramp.exr out2.png
	[ ! -e out2.png ]
}

@test "--crop and --zoom" {
	ramp
	run -0 gdshow --crop 4,-2,2,-1 --zoom 8 ramp.exr out.png
	[ "$(size out.png)" = "16 8 8" ]
	mkexr two.exr 16 8 R='$x < 8 ? 4/15 : 5/15' G=2/7 B=0.2
	same out.png two.exr
	run -2 gdshow --crop 0,99,0,1 ramp.exr out.png
	run -2 gdshow --zoom 0 ramp.exr out.png
}

@test "--sheet: images side by side, layers below, --labels, --columns, --legend" {
	ramp
	run -0 gdshow --sheet ramp.exr ramp.exr ramp.exr -o sheet.png
	[ "$(size sheet.png)" = "60 26 8" ]
	run -0 gdshow --sheet -l colour,Z ramp.exr ramp.exr -o sheet.png
	[ "$(size sheet.png)" = "41 49 8" ]
	run -0 gdshow --sheet --columns 1 --labels a,b,c ramp.exr ramp.exr ramp.exr -o sheet.png
	[ "$(size sheet.png)" = "22 72 8" ]
	run -0 gdshow --sheet --labels ,,c ramp.exr ramp.exr -o sheet.png
	[ "$(size sheet.png)" = "41 14 8" ]
	run -0 gdshow --legend -l Z ramp.exr -o legend.png
	[ "$(size legend.png)" = "16 26 8" ]
	gdshow --sheet ramp.exr ramp.exr >piped.png
	gdshow --sheet ramp.exr ramp.exr -o sheet.png
	cmp piped.png sheet.png
	run -2 gdshow ramp.exr ramp.exr ramp.exr
	run -2 gdshow -l Z,dx ramp.exr out.png
	run -2 gdshow --labels a ramp.exr out.png
}

@test "no PNG over an EXR, no endless range, no picture that fills the memory" {
	ramp
	cp ramp.exr other.exr
	run -2 --separate-stderr gdshow ramp.exr other.exr
	[[ $stderr == *"use --sheet" ]]
	cmp ramp.exr other.exr
	run -2 gdshow -l Z --range 0,inf ramp.exr out.png
	mkexr wide.exr 2000 9 Z=1
	run -2 --separate-stderr gdshow --zoom 64 -l Z wide.exr out.png
	mkexr big.exr 1000 40 Z=1
	run -2 --separate-stderr gdshow --sheet --zoom 64 -l Z,Z,Z big.exr -o out.png
	[ "${#stderr_lines[@]}" -eq 1 ]
	[[ $stderr == *megapixels ]]
	[ ! -e out.png ]
}

@test "NaN pixels are magenta and counted" {
	mkexr nan.exr 4 4 R='$x == 2 ? nan() : 0' G=0 B=0
	mkexr magenta.exr 4 4 R='$x == 2' G=0 B='$x == 2'
	run -0 --separate-stderr gdshow nan.exr out.png
	[[ $stderr == *"4 pixels with NaN"* ]]
	same out.png magenta.exr
}

@test "a grey image, a whole file or none, a missing channel" {
	mkexr grey.exr 5 5 Y='$x/4'
	mkexr rgb.exr 5 5 R='$x/4' G='$x/4' B='$x/4'
	run -0 gdshow grey.exr out.png
	same out.png rgb.exr
	run -2 --separate-stderr gdshow -l albedo rgb.exr none.png
	[[ $stderr == "gdshow: rgb.exr: no channel albedo"* ]]
	[ "${#stderr_lines[@]}" -eq 1 ]
	run -2 gdshow rgb.exr /dev/full
	run -2 gdshow rgb.exr missing/out.png
	head -c 420 rgb.exr >cut.exr
	run -2 gdshow cut.exr none.png
	[ ! -e none.png ]
	[ "$(ls | grep -c tmp)" -eq 0 ]
}

@test "other formats come in through the plug-in" {
	ramp
	gdshow --bits 16 ramp.exr a.png
	gdshow --bits 16 a.png b.png
	same b.png ramp.exr 1e-8
	echo text >not.tif
	run -2 --separate-stderr gdshow not.tif c.png
	[[ $stderr == "gdshow: not.tif"* ]]
}
