#!/usr/bin/awk -f
# SPDX-License-Identifier: BSD-3-Clause
# Tables of gdrelmse --format tsv, one after another, to one table of scenes, inputs and methods.
BEGIN {
	FS = OFS = "\t"
	print "scene", "method", "relMSE", "trimmed", "seconds", "bias_percent", "rank", "pixels", "render_seconds"
}
$1 == "image" {
	split("", col)
	for (i = 1; i <= NF; i++)
		col[$i] = i
	next
}
NF > 1 {
	name = $1
	if (index(name, data) == 1)
		name = substr(name, length(data) + 1)
	if (index(name, out) == 1)
		name = substr(name, length(out) + 1)
	split(name, part, "/")
	sub(/[.]exr$/, "", part[2])
	method = part[2]
	if (!sub(/\./, "-", method))
		method = method "-input"
	s = $col["seconds"]
	rank = ("rank" in col) ? $col["rank"] : "NA"
	print part[1], method, $col["relmse"], $col["trimmed"], s == "NA" ? 0 : s, $col["bias_percent"], rank,
		$col["pixels"], $col["render_seconds"]
}
