#!/usr/bin/awk -f
# SPDX-License-Identifier: BSD-3-Clause
# compare.awk peers.tsv errors.tsv: errors with those of other programs on the same input between them.
BEGIN {
	FS = "\t"
	head = "%-9s %-9s %-13s %9s %9s %8s %7s %6s %8s\n"
	row = "%-9s %-9s %-13s %9.5f %9s %8.2f %7s %6s %8s\n"
}
FNR == 1 { files++; next }
files == 1 {
	key = $1 "/" $2
	peers[key] = peers[key] $3 FS $4 FS $5 "\n"
	if ($3 ~ /^(nfor|frgr)/ && (!(key in best) || $4 < best[key]))
		best[key] = $4
	next
}
{
	split($2, part, "-")
	key = $1 "/" part[1]
	method = substr($2, length(part[1]) + 2)
	whole = $8 == 256 * 192
	if (key != was) {
		if (was == "") {
			printf "relMSE and seconds of denoising (256 x 192; wall seconds of ours on this machine). (nfor) and the\n"
			printf "like: published figures of other programs on the same files, CPU seconds, from peers.tsv. against:\n"
			printf "relative to the better of NFOR and FRGR. rank: correlation of estimated and true error.\n\n"
			printf head, "scene", "input", "method", "relMSE", "trimmed", "seconds", "bias%", "rank", "against"
		}
		print ""
		was = key
		if (whole && key in peers) {
			n = split(peers[key], line, "\n")
			for (i = 1; i < n; i++) {
				split(line[i], f, FS)
				if (f[1] != "input")
					printf row, $1, part[1], "(" f[1] ")", f[2], "", f[3], "", "",
						sprintf("%.3f", f[2] / best[key])
			}
		}
	}
	printf row, $1, part[1], method, $3, sprintf("%.5f", $4), $5, sprintf("%.2f", $6),
		$7 == "NA" ? "" : sprintf("%.2f", $7), whole && key in best ? sprintf("%.3f", $3 / best[key]) : ""
}
