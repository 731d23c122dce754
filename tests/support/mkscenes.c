/* SPDX-License-Identifier: BSD-3-Clause */
/* mkscenes FOLDER: writes the scenes of testdata/scenes. */
#include "scene_bathroom.h"
#include "scene_caustic.h"
#include "scene_dof.h"
#include "scene_door.h"
#include "scene_kitchen.h"
#include "scene_sequence.h"

static const struct {
	const char *name;
	int w, h;
	picture *picture;
} pictures[] = {
	{ "granite.png", 128, 128, granite }, { "wood.png", 128, 128, wood },
	{ "boards.png", 192, 192, boards },   { "check.png", 128, 128, check },
	{ "tiles.png", 192, 192, tiles },     { "mosaic.png", 128, 128, mosaic },
	{ "terry.png", 128, 128, terry },     { "wallpaper.png", 128, 128, wallpaper },
	{ "rug.png", 128, 128, rug },         { "gravel.png", 96, 96, gravel },
	{ "bricks.png", 128, 128, bricks },   { "globe.png", 256, 128, globe_map },
};

int main(int argc, char **argv)
{
	if (argc != 2) {
		fprintf(stderr, "usage: mkscenes FOLDER\n");
		return 2;
	}
	for (int i = 0; i < COUNT(pictures); i++)
		picture_write(argv[1], pictures[i].name, pictures[i].w, pictures[i].h,
			      pictures[i].picture);
	bathroom(argv[1]);
	caustic(argv[1]);
	dof(argv[1]);
	door(argv[1]);
	kitchen(argv[1]);
	sequence(argv[1]);
	return 0;
}
