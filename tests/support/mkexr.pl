#!/usr/bin/perl
# SPDX-License-Identifier: BSD-3-Clause
# Writes a small uncompressed float EXR for tests, from formulas. It shares no code with the toolkit.
#	mkexr.pl OUT.exr WIDTH HEIGHT [-o X0,Y0] [-s SEED] [-a NAME=VALUE]... CHANNEL=FORMULA...
# -o   where the data window begins (0,0); the display window is the same
# -a   an attribute: float if VALUE is a number, else string
# A FORMULA is perl with $x, $y (from 0), $w, $h; noise() is Gaussian of variance 1,
# linear(v) decodes sRGB, and nan() and inf() exist.
# Each channel draws its noise from SEED and its own name, so that it does not depend on the others.
use strict;
use warnings;

sub nan { return unpack('f<', pack('V', 0x7fc00000)) }
sub inf { return 9**9**9 }
sub linear { my ($v) = @_; return $v <= 0.04045 ? $v / 12.92 : (($v + 0.055) / 1.055)**2.4 }
sub noise {
	my $u = rand() || 1e-12;
	return sqrt(-2 * log($u)) * cos(6.283185307179586 * rand());
}

my ($out, $w, $h, @rest) = @ARGV;
die "usage: mkexr.pl OUT.exr WIDTH HEIGHT [-o X0,Y0] [-s SEED] [-a NAME=VALUE]... CHANNEL=FORMULA...\n" if @rest < 1;
my ($x0, $y0, $seed, @attr, %chan) = (0, 0, 1);
while (defined(my $arg = shift @rest)) {
	if ($arg eq '-o') { ($x0, $y0) = split /,/, shift @rest }
	elsif ($arg eq '-s') { $seed = shift @rest }
	elsif ($arg eq '-a') { push @attr, shift @rest }
	else { my ($name, $formula) = $arg =~ /^([^=]+)=(.*)$/s or die "mkexr.pl: $arg\n"; $chan{$name} = $formula }
}

sub attr { my ($name, $type, $data) = @_; return "$name\0$type\0" . pack('V', length $data) . $data }

my @names = sort keys %chan;
my $list = join('', map { "$_\0" . pack('V C x3 V V', 2, 0, 1, 1) } @names) . "\0";
my $box = pack('l<4', $x0, $y0, $x0 + $w - 1, $y0 + $h - 1);
my $long = grep { length > 31 } @names;
my $head = pack('V V', 20000630, $long ? 0x402 : 2);
$head .= attr('channels', 'chlist', $list) . attr('compression', 'compression', "\0");
$head .= attr('dataWindow', 'box2i', $box) . attr('displayWindow', 'box2i', $box) . attr('lineOrder', 'lineOrder', "\0");
$head .= attr('pixelAspectRatio', 'float', pack('f<', 1));
$head .= attr('screenWindowCenter', 'v2f', pack('f<2', 0, 0)) . attr('screenWindowWidth', 'float', pack('f<', 1));
for (@attr) {
	my ($name, $value) = /^([^=]+)=(.*)$/s or die "mkexr.pl: attribute $_\n";
	my $number = $value =~ /^-?[\d.]+(e-?\d+)?$/i;
	$head .= attr($name, $number ? 'float' : 'string', $number ? pack('f<', $value) : $value);
}
$head .= "\0";

my @plane;
for my $name (@names) {
	my $f = eval "sub { my (\$x, \$y) = \@_; $chan{$name} }" or die "mkexr.pl: $name: $@";
	my $sum = $seed;
	$sum = ($sum * 31 + ord) % 1000003 for split //, $name;
	srand($sum);
	push @plane, [map { my $y = $_; pack('f<*', map { $f->($_, $y) } 0 .. $w - 1) } 0 .. $h - 1];
}
my $row = 4 * $w * @names;
open(my $file, '>:raw', $out) or die "mkexr.pl: $out: $!\n";
print $file $head, map { pack('Q<', length($head) + 8 * $h + $_ * (8 + $row)) } 0 .. $h - 1;
for my $y (0 .. $h - 1) {
	print $file pack('l< V', $y0 + $y, $row), map { $_->[$y] } @plane;
}
close($file) or die "mkexr.pl: $out: $!\n";
