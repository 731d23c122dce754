#!/usr/bin/perl
# SPDX-License-Identifier: BSD-3-Clause
# Reads an uncompressed scanline EXR for tests. It shares no code with the toolkit.
#	exrval.pl FILE				channels as NAME:TYPE, one a line
#	exrval.pl FILE @NAME			an attribute
#	exrval.pl FILE CHANNEL X Y		one pixel, x and y from 0
#	exrval.pl FILE CHANNEL			mean of the channel
use strict;
use warnings;

my ($path, $what, $px, $py) = @ARGV;
open(my $f, '<:raw', $path) or die "exrval.pl: $path: $!\n";
my $d = do { local $/; <$f> };
my ($o, %attr) = (8);
while (ord substr($d, $o, 1)) {
	my $end = index($d, "\0", $o);
	my $name = substr($d, $o, $end - $o);
	my $end2 = index($d, "\0", $end + 1);
	my $size = unpack('V', substr($d, $end2 + 1, 4));
	$attr{$name} = [substr($d, $end + 1, $end2 - $end - 1), substr($d, $end2 + 5, $size)];
	$o = $end2 + 5 + $size;
}
$o++;
my (@chan, $q);
for ($q = 0; ord substr($attr{channels}[1], $q, 1);) {
	my $end = index($attr{channels}[1], "\0", $q);
	push @chan, [substr($attr{channels}[1], $q, $end - $q), unpack('V', substr($attr{channels}[1], $end + 1, 4))];
	$q = $end + 17;
}
if (!defined $what) { print "$_->[0]:", ('uint', 'half', 'float')[$_->[1]], "\n" for @chan; exit }
if ($what =~ s/^@//) {
	my $a = $attr{$what} or exit 1;
	my ($type, $data) = @$a;
	print $type eq 'float' ? unpack('f<', $data) : $type eq 'int' ? unpack('l<', $data) : $data, "\n";
	exit;
}
die "exrval.pl: $path is compressed\n" if ord $attr{compression}[1];
my ($x0, $y0, $x1, $y1) = unpack('l<4', $attr{dataWindow}[1]);
my ($w, $h) = ($x1 - $x0 + 1, $y1 - $y0 + 1);

sub half {
	my $v = shift;
	my ($s, $e, $m) = ($v >> 15, ($v >> 10) & 31, $v & 1023);
	my $r = $e == 31 ? ($m ? 'NaN' + 0 : 9**9**9) : $e ? (1 + $m / 1024) * 2**($e - 15) : $m * 2**-24;
	return $s ? -$r : $r;
}
sub row {
	my $y = shift;
	my $at = unpack('Q<', substr($d, $o + 8 * $y, 8)) + 8;
	for (@chan) {
		my $bytes = $w * ($_->[1] == 1 ? 2 : 4);
		my $raw = substr($d, $at, $bytes);
		return $_->[1] == 1 ? map({ half($_) } unpack('v*', $raw)) : unpack($_->[1] ? 'f<*' : 'V*', $raw)
			if $_->[0] eq $what;
		$at += $bytes;
	}
	die "exrval.pl: $path: no channel $what\n";
}
if (defined $py) { printf "%.9g\n", (row($py))[$px]; exit }
my $sum = 0;
for my $y (0 .. $h - 1) { $sum += $_ for row($y) }
printf "%.9g\n", $sum / $w / $h;
