#!/bin/bash
# SPDX-License-Identifier: BSD-3-Clause
# The main job on real samples: a crop of a kitchen, rendered by gradient-domain path tracing.
#	tests/demo.sh TESTDATA OUT		the tools are those of $GD_BIN (bin)
# Then a scene is rendered, evenly and in passes that go where samples help, and both are measured.
# Leaves images, pictures, tables of relMSE against seconds and plots of them in OUT.
set -euo pipefail
data=$1 out=$2
PATH=$(realpath "${GD_BIN:-bin}"):$PATH
unset SOURCE_DATE_EPOCH	# with it no seconds are written
gbuffers=albedo,N,Z

denoise() {	# SCENE INPUT-FILE LABEL-PREFIX: every method on one gradient-domain input
	local dir=$out/$1 in=$2 p=$3
	gdsolve --method l2 "$in" -o "$dir/$p-l2.exr"
	gdsolve --method l1 "$in" -o "$dir/$p-l1.exr"
	gdfeature "$in" -o "$dir/$p-feature.exr"
	gdapr --paper --features $gbuffers "$in" -o "$dir/$p-apr-gbuffers.exr"
	gdapr --paper --features feature "$dir/$p-feature.exr" -o "$dir/$p-apr-feature.exr"
	gdapr --paper --features $gbuffers,feature "$dir/$p-feature.exr" -o "$dir/$p-apr-both.exr"
	gdlwr "$dir/$p-feature.exr" -o "$dir/$p-lwr.exr"
	gdapr "$dir/$p-feature.exr" -o "$dir/$p-default.exr"
}

rows() {	# SCENE NAME=FILE...: lines of the table
	local scene=$1
	shift
	gdrelmse --format tsv -r "$data/$scene/reference.exr" "${@#*=}" | awk -F'\t' -v OFS='\t' -v scene="$scene" \
		-v names="${*%%=*}" '
		NR == 1 { for (i = 1; i <= NF; i++) col[$i] = i; split(names, name, " "); next }
		{ s = $col["seconds"]; print scene, name[NR - 1], $col["relmse"], $col["trimmed"], s == "NA" ? 0 : s,
			$col["render_seconds"] }'
}

rm -rf "$out"
mkdir -p "$out/kitchen" "$out/door"
k=$out/kitchen d=$out/door

echo "kitchen, four renders of 2 samples a pixel: gdmerge run*.exr | gdfeature | gdapr -o clean.exr"
gdmerge "$data"/kitchen/run*.exr | gdfeature | gdapr -o "$k/clean.exr"
gdmerge "$data"/kitchen/run*.exr -o "$k/8spp.exr"
denoise kitchen "$k/8spp.exr" 8spp
echo "kitchen, 16 samples a pixel, and path tracing of the same cost"
denoise kitchen "$data/kitchen/gpt16.exr" 16spp
gdapr "$data/kitchen/path16eq.exr" -o "$k/path-default.exr"
gdlwr "$data/kitchen/path16eq.exr" -o "$k/path-lwr.exr"
echo "door, 16 samples a pixel"
denoise door "$data/door/gpt16.exr" 16spp

methods() {	# DIR PREFIX: the arguments of rows()
	local m
	for m in l2 l1 apr-gbuffers apr-feature apr-both lwr default; do echo "$2-$m=$1/$2-$m.exr"; done
}
{
	printf 'scene\tmethod\trelMSE\ttrimmed\tseconds\trender_seconds\n'
	mapfile -t m < <(methods "$k" 8spp)
	rows kitchen 8spp-input="$k/8spp.exr" "${m[@]}"
	mapfile -t m < <(methods "$k" 16spp)
	rows kitchen 16spp-input="$data/kitchen/gpt16.exr" "${m[@]}" \
		path-input="$data/kitchen/path16eq.exr" path-lwr="$k/path-lwr.exr" path-default="$k/path-default.exr"
	mapfile -t m < <(methods "$d" 16spp)
	rows door 16spp-input="$data/door/gpt16.exr" "${m[@]}"
} >"$out/table.tsv"
{
	echo "relMSE against seconds of denoising. 8spp, 16spp: gradient-domain path tracing with 8 and 16 samples a"
	echo "pixel; path: plain path tracing in the render time of 16spp. apr-*: adaptive polynomial rendering as"
	echo "published, with G-buffers, the feature made from gradients, and both; lwr: gdfeature | gdlwr; default:"
	echo "gdfeature | gdapr."
	echo "render: CPU seconds."
	echo
	awk -F'\t' 'NR == 1 { printf "%-8s %-19s %10s %10s %9s %9s\n", $1, $2, $3, $4, $5, "render"; next }
		$1 != was { if (was) print ""; was = $1 }
		{ printf "%-8s %-19s %10.5f %10.5f %9.2f %9.2f\n", $1, $2, $3, $4, $5, $6 }' "$out/table.tsv"
} | tee "$out/table.txt"

if gdshow -q "$data/kitchen/reference.exr" "$out/reference.png" 2>/dev/null; then
	gdshow "$k/8spp.exr" "$out/noisy.png"
	gdshow "$k/clean.exr" "$out/clean.png"
	gdshow --sheet --zoom 2 --columns 4 --labels \
		"input 8 spp,L2,L1,reference,APR G-buffers,APR both,gdfeature | gdlwr,gdfeature | gdapr" -o "$out/kitchen.png" \
		"$k/8spp.exr" "$k/8spp-l2.exr" "$k/8spp-l1.exr" "$data/kitchen/reference.exr" \
		"$k/8spp-apr-gbuffers.exr" "$k/8spp-apr-both.exr" "$k/8spp-lwr.exr" "$k/8spp-default.exr"
	gdshow --sheet --zoom 2 --columns 4 --labels \
		"input 16 spp,L2,L1,reference,APR G-buffers,APR both,gdfeature | gdlwr,gdfeature | gdapr" -o "$out/door.png" \
		"$data/door/gpt16.exr" "$d/16spp-l2.exr" "$d/16spp-l1.exr" "$data/door/reference.exr" \
		"$d/16spp-apr-gbuffers.exr" "$d/16spp-apr-both.exr" "$d/16spp-lwr.exr" "$d/16spp-default.exr"
	gdshow --layer error --legend --zoom 2 "$k/clean.exr" "$out/error.png"
	gdsample --spp 8 --max 64 --png "$out/sampling.png" "$k/clean.exr" -o "$k/sampling.exr"
else
	echo "no pictures: they need the plug-in with OpenImageIO and OpenColorIO (make deps; make)"
fi

if command -v gnuplot >/dev/null; then
	"$(dirname "$0")/bench/plot.sh" "$out/table.tsv" "$out/plot.png"
else
	echo "no plot: gnuplot is not installed (make deps)"
fi
# ---- rendered here ----

scenes=$(dirname "$0")/../testdata/scenes
loop=$out/render/kitchen.192/gpt-adaptive.exr.passes
if ! command -v gdrender >/dev/null; then
	echo "nothing rendered: gdrender was not built, it needs Embree, assimp and cJSON (make deps; make)"
else
	echo
	echo "kitchen, rendered at 192x144: a reference; even passes, and passes that go where samples help"
	bin=$(dirname "$(command -v gdrender)")
	REF_SIZE=192x144 REF_PASSES=2 REF_SPP=${DEMO_REFERENCE:-192} \
		"$(dirname "$0")/references.sh" "$bin" "$scenes" "$out/references" kitchen
	RENDER_SPP=${DEMO_SPP:-48 192} RENDER_METHODS="path path-apr gpt-l2 gpt-apr path-adaptive gpt-adaptive" \
		"$(dirname "$0")/bench/render.sh" "$bin" "$scenes" "$out/references" "$out/render" kitchen >"$out/render.log"
	sed 1,/^relMSE/d "$out/render.log" | cat <(echo "relMSE at equal time, rendering included, and its ratio to path-apr:") -
	cp "$out/render/render.tsv" "$out/render.tsv"
	[ -f "$out/render/render.png" ] && cp "$out/render/render.png" "$out/render.png"
	if [ -f "$out/reference.png" ] && [ -d "$loop" ]; then
		gdshow --sheet --zoom 2 --columns 3 --labels "path 192 spp,denoised,gradients L2,gradients denoised,3 passes,reference" \
			-o "$out/rendered.png" "$out/render/kitchen.192/path.exr" "$out/render/kitchen.192/path-apr.exr" \
			"$out/render/kitchen.192/gpt-l2.exr" "$out/render/kitchen.192/gpt-apr.exr" \
			"$out/render/kitchen.192/gpt-adaptive.exr" "$out/references/kitchen.exr"
		gdshow --layer sampling --legend --zoom 2 "$loop/map2.exr" "$out/passes.png"
	fi
fi
echo
echo "Look at $out/: table.txt table.tsv$(cd "$out" && for f in kitchen door noisy clean error sampling plot render rendered passes; do
	[ -f $f.png ] && printf ' %s.png' $f; done)"
