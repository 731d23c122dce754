#!/usr/bin/awk -f
# SPDX-License-Identifier: BSD-3-Clause
# From scene, method, spp, seconds, relMSE (a table with a head) to errors at equal time: each method's curve is
# taken as straight pieces in logarithms of both, at the longest time that every method of a scene reaches; ~:
# beyond what was measured, by the nearest piece. The error comes with its ratio to that of path-apr.
BEGIN { FS = "\t"; base = "path-apr" }
NR == 1 { next }
{
	if (!($1 in seen)) { seen[$1]; scene[++scenes] = $1 }
	if (!($2 in known)) { known[$2]; method[++methods] = $2 }
	k = $1 FS $2
	t[k, ++n[k]] = log($4)
	e[k, n[k]] = log($5 > 1e-9 ? $5 : 1e-9)
	if (t[k, n[k]] > last[k] || n[k] == 1) last[k] = t[k, n[k]]
}
function at(k, when,	i, a, b, best, d, slope) {
	guess = ""
	if (n[k] == 1) { if ((d = when - t[k, 1]) > 0.1 || d < -0.1) guess = "~"; return e[k, 1] - d * 0.5 }
	best = -1
	for (i = 1; i < n[k]; i++) {	# the piece that holds it, or the nearest
		d = when < t[k, i] ? t[k, i] - when : when > t[k, i + 1] ? when - t[k, i + 1] : 0
		if (best < 0 || d < best) { best = d; a = i }
	}
	b = a + 1
	slope = t[k, b] > t[k, a] ? (e[k, b] - e[k, a]) / (t[k, b] - t[k, a]) : 0
	if (best > 0.1) {	# an error falls with time, by no more than 1 / time
		guess = "~"
		slope = slope < -1 ? -1 : slope > 0 ? 0 : slope
	}
	if (when > t[k, b]) return e[k, b] + slope * (when - t[k, b])
	return e[k, a] + slope * (when - t[k, a])
}
END {
	line = sprintf("%-16s", "method")
	for (s = 1; s <= scenes; s++) {
		first = 1
		for (m = 1; m <= methods; m++) {
			k = scene[s] FS method[m]
			if (k in n && (first || last[k] < when[s])) { when[s] = last[k]; first = 0 }
		}
		line = line sprintf("  %18s", scene[s])
	}
	print "relMSE at equal time, and its ratio to that of " base
	print line
	line = sprintf("%-16s", "seconds")
	for (s = 1; s <= scenes; s++) line = line sprintf("  %18.2f", exp(when[s]))
	print line
	for (m = 1; m <= methods; m++) {
		line = sprintf("%-16s", method[m])
		for (s = 1; s <= scenes; s++) {
			k = scene[s] FS method[m]
			if (!(k in n)) { line = line sprintf("  %18s", "-"); continue }
			own = at(k, when[s]); mark = guess
			text = sprintf("%.5f%s", exp(own), mark)
			if ((scene[s] FS base) in n) text = text sprintf(" %6.3f", exp(own - at(scene[s] FS base, when[s])))
			line = line sprintf("  %18s", text)
		}
		print line
	}
}
