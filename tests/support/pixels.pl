#!/usr/bin/perl
# SPDX-License-Identifier: BSD-3-Clause
# Everything of a scanline EXR but its attributes: channel list, windows and the bytes of the pixels.
use strict;
use warnings;

open(my $f, '<:raw', $ARGV[0]) or die "pixels.pl: $ARGV[0]: $!\n";
my $d = do { local $/; <$f> };
my $o = 8;
my ($y0, $y1) = (0, 0);
binmode STDOUT;
while (ord substr($d, $o, 1)) {
	my $end = index($d, "\0", $o);
	my $name = substr($d, $o, $end - $o);
	my $end2 = index($d, "\0", $end + 1);
	my $size = unpack('V', substr($d, $end2 + 1, 4));
	my $data = substr($d, $end2 + 5, $size);
	print $name, $data if $name =~ /^(channels|compression|dataWindow|displayWindow)$/;
	$o = $end2 + 5 + $size;
}
# The table of offsets depends on the size of the header; the first offset ends it.
my $first = unpack('Q<', substr($d, $o + 1, 8));
print substr($d, $first);
