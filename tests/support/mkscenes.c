/* SPDX-License-Identifier: BSD-3-Clause */
/* mkscenes FOLDER: writes the scenes of testdata/scenes. */
#include "scene_kitchen.h"

static const struct {
	const char *name;
	int w, h;
	picture *picture;
} pictures[] = {
	{ "granite.png", 128, 128, granite },
	{ "wood.png", 128, 128, wood },
	{ "boards.png", 192, 192, boards },
	{ "check.png", 128, 128, check },
};

int main(int argc, char **argv)
{
	if (argc != 2) {
		fprintf(stderr, "usage: mkscenes FOLDER\n");
		return 2;
	}
	for (int i = 0; i < COUNT(pictures); i++)
		picture_write(argv[1], pictures[i].name, pictures[i].w, pictures[i].h, pictures[i].picture);
	kitchen(argv[1]);
	return 0;
}
