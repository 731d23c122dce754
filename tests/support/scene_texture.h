/* SPDX-License-Identifier: BSD-3-Clause */
/* Noise that is the same everywhere, and textures made of it, written as PNG; they repeat. */
#ifndef SCENE_TEXTURE_H
#define SCENE_TEXTURE_H

#include <zlib.h>

#include "scene_file.h"

/* 0 .. 1 */
static double noise_at(int x, int y, unsigned seed)
{
	uint32_t h = (uint32_t)x * 0x9e3779b1u ^ (uint32_t)y * 0x85ebca77u ^ seed * 0xc2b2ae3du;

	h = (h ^ h >> 15) * 0x2c1b3c6du;
	h = (h ^ h >> 12) * 0x297a2d39u;
	return (h ^ h >> 15) / 4294967296.0;
}

/* Smooth noise, 0 .. 1, of cells of length 1; repeats after period cells. */
static double noise(double x, double y, int period, unsigned seed)
{
	const double fx = floor(x), fy = floor(y), a = x - fx, b = y - fy;
	const double u = a * a * (3 - 2 * a), v = b * b * (3 - 2 * b);
	const int x0 = (((int)fx % period) + period) % period,
		  y0 = (((int)fy % period) + period) % period;
	const int x1 = (x0 + 1) % period, y1 = (y0 + 1) % period;
	const double top = noise_at(x0, y0, seed) * (1 - u) + noise_at(x1, y0, seed) * u;
	const double low = noise_at(x0, y1, seed) * (1 - u) + noise_at(x1, y1, seed) * u;

	return top * (1 - v) + low * v;
}

/* Sum of octaves, about 0 .. 1; x, y in 0 .. 1 repeat. */
static double clouds(double x, double y, int cells, int octaves, unsigned seed)
{
	double sum = 0, size = 0.5, all = 0;

	for (int k = 0; k < octaves; k++, size /= 2, cells *= 2) {
		sum += size * noise(x * cells, y * cells, cells, seed + (unsigned)k);
		all += size;
	}
	return sum / all;
}

static double mix(double a, double b, double t)
{
	return a + (b - a) * fmin(fmax(t, 0), 1);
}

static double smooth(double a, double b, double x)
{
	const double t = fmin(fmax((x - a) / (b - a), 0), 1);

	return t * t * (3 - 2 * t);
}

/* sRGB values 0 .. 1 at (u, v) in 0 .. 1, v down. */
typedef void picture(double u, double v, double rgb[3]);

static void chunk(FILE *f, const char *type, const unsigned char *data, size_t n)
{
	const uint32_t crc =
		(uint32_t)crc32(crc32(0, (const unsigned char *)type, 4), data, (uInt)n);

	for (int k = 24; k >= 0; k -= 8)
		putc((int)(n >> k & 255), f);
	fwrite(type, 1, 4, f);
	if (n)
		fwrite(data, 1, n, f);
	for (int k = 24; k >= 0; k -= 8)
		putc((int)(crc >> k & 255), f);
}

/* RGB in steps of 4 of 256 levels, which compress better. */
static void picture_write(const char *folder, const char *name, int w, int h, picture *p)
{
	static const unsigned char magic[8] = { 137, 'P', 'N', 'G', 13, 10, 26, 10 };
	unsigned char head[13] = { 0,
				   0,
				   (unsigned char)(w >> 8),
				   (unsigned char)w,
				   0,
				   0,
				   (unsigned char)(h >> 8),
				   (unsigned char)h,
				   8,
				   2,
				   0,
				   0,
				   0 };
	const size_t row = 3 * (size_t)w + 1, n = row * (size_t)h;
	unsigned char *raw = need(calloc(n, 1)), *packed;
	uLongf size = compressBound(n);
	FILE *f = create(folder, name);

	packed = need(malloc(size));
	for (int y = 0; y < h; y++)
		for (int x = 0; x < w; x++) {
			double c[3];

			p((x + 0.5) / w, (y + 0.5) / h, c);
			for (int k = 0; k < 3; k++)
				raw[(size_t)y * row + 1 + 3 * (size_t)x + (size_t)k] =
					(unsigned char)(4 * nearbyint(fmin(fmax(c[k], 0), 1) * 63));
		}
	if (compress2(packed, &size, raw, n, 9) != Z_OK) {
		fprintf(stderr, "mkscenes: %s: cannot compress\n", name);
		exit(2);
	}
	fwrite(magic, 1, sizeof magic, f);
	chunk(f, "IHDR", head, sizeof head);
	chunk(f, "IDAT", packed, size);
	chunk(f, "IEND", NULL, 0);
	done(f);
	free(packed);
	free(raw);
}

/* --- pictures --- */

static void granite(double u, double v, double c[3])
{
	const double big = clouds(u, v, 6, 4, 11), grain = clouds(u, v, 48, 2, 23);
	const double spot = smooth(0.66, 0.72, grain), dark = smooth(0.36, 0.30, grain);
	const double g = mix(0.22, 0.36, big) + 0.30 * spot - 0.12 * dark;

	c[0] = g, c[1] = g * 0.98, c[2] = g * 0.96;
}

/* Grain along v. */
static void wood(double u, double v, double c[3])
{
	const double bend = 0.06 * clouds(u, v, 3, 2, 5);
	const double ring = noise((u + bend) * 14, v * 1, 14, 31);
	const double line = noise((u + 0.2 * bend) * 96, v * 4, 96, 7),
		     t = 0.65 * ring + 0.35 * line;

	c[0] = mix(0.45, 0.80, t), c[1] = mix(0.28, 0.60, t), c[2] = mix(0.15, 0.40, t);
}

/* Boards of wood, 4 to a side, across which their joints lie at different heights. */
static void boards(double u, double v, double c[3])
{
	const int board = (int)(u * 4);
	const double x = u * 4 - board, y = v + 0.37 * board, joint = fabs(y - floor(y) - 0.5);
	const double shade = mix(0.75, 1.1, noise_at(board, 5, 99));
	const double gap =
		smooth(0.012, 0.03, x) * smooth(0.012, 0.03, 1 - x) * smooth(0.003, 0.006, joint);

	wood(u, v * 0.999, c);
	for (int k = 0; k < 3; k++)
		c[k] *= shade * mix(0.3, 1, gap);
}

/* Checked cloth. */
static void check(double u, double v, double c[3])
{
	const double a = u * 8 - floor(u * 8) < 0.5, b = v * 8 - floor(v * 8) < 0.5,
		     t = (a + b) / 2;
	const double weave_ = 0.94 + 0.06 * noise_at((int)(u * 128), (int)(v * 128), 3);

	c[0] = weave_ * mix(0.94, 0.75, t), c[1] = weave_ * mix(0.92, 0.16, t),
	c[2] = weave_ * mix(0.86, 0.14, t);
}

#endif
