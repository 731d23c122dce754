/* SPDX-License-Identifier: BSD-3-Clause */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "names.h"

static void image_of(struct gd_image *im, const char *list)
{
	char *copy = strdup(list), *save = NULL;

	gd_image_init(im, 1, 1);
	for (char *name = strtok_r(copy, ";", &save); name; name = strtok_r(NULL, ";", &save)) {
		bool uint = *name == '#';

		assert_int_equal(gd_image_append(im, name + uint, uint ? GD_UINT : GD_HALF, NULL),
				 GD_OK);
	}
	free(copy);
}

static const char roles[] = { 'm', 'v', 's', 'p', 'd' };

/* "layer<role>=source>names" of every layer, in the order found: enough to compare at a glance. */
static void check(const char *channels, struct gd_names_conf conf, enum gd_preset preset,
		  const char *expected)
{
	struct gd_image im;
	struct gd_names names = { 0 };
	struct gd_err err = { 0 };
	char got[4096] = "", text[600];
	int uses = 0;

	image_of(&im, channels);
	if (gd_names_resolve(&names, &im, &conf, &err) != GD_OK)
		fail_msg("%s", err.text);
	assert_int_equal(names.preset, preset);
	for (int k = 0; k < names.n; k++) {
		const struct gd_named *l = &names.layer[k];

		gd_named_describe(l, &im, text, sizeof text);
		sprintf(got + strlen(got), "%s%c:%s=%s", k ? " | " : "", roles[l->role], l->layer,
			text);
		if (l->renamed)
			strcat(got, "*");
		for (int i = 0; i < l->n && l->role != GD_ROLE_PASS && l->role != GD_ROLE_DROP; i++)
			assert_true(*l->name[i]);
		uses += l->n;
	}
	if (strcmp(got, expected))
		fail_msg("\ngot      %s\nexpected %s", got, expected);
	assert_true(uses >= im.nchan);
	gd_names_free(&names);
	gd_image_free(&im);
}

static const struct gd_names_conf automatic;

static void test_own_names(void **state)
{
	(void)state;
	check("A;B;G;N.X;N.Y;N.Z;N.variance.X;N.variance.Y;N.variance.Z;R;Z;Z.variance;bin0.R;bin0."
	      "G;bin0.B;bin0.dx.R;"
	      "bin0.dx.G;bin0.dx.B;dx.R;dx.G;dx.B;half0.Z;samples;variance.R;variance.G;variance.B",
	      automatic, GD_NAMES_GD,
	      "m:={R,G,B} | m:N=N.{X,Y,Z} | m:Z=Z | m:A=A | v:N=N.variance.{X,Y,Z} | "
	      "v:Z=Z.variance | m:bin0=bin0.{R,G,B} | "
	      "m:bin0.dx=bin0.dx.{R,G,B} | m:dx=dx.{R,G,B} | m:half0.Z=half0.Z | s:samples=samples "
	      "| v:=variance.{R,G,B}");
}

static void test_pbrt(void **state)
{
	(void)state;
	check("R;G;B;Albedo.R;Albedo.G;Albedo.B;N.X;N.Y;N.Z;Ns.X;Ns.Y;Ns.Z;P.X;P.Y;P.Z;"
	      "RelativeVariance.R;"
	      "RelativeVariance.G;RelativeVariance.B;Variance.R;Variance.G;Variance.B;u",
	      automatic, GD_NAMES_PBRT,
	      "v:=Variance.{R,G,B}* | m:albedo=Albedo.{R,G,B}* | m:N=Ns.{X,Y,Z}* | m:Ng=N.{X,Y,Z}* "
	      "| m:P=P.{X,Y,Z} | "
	      "d:drop=RelativeVariance.{R,G,B}* | m:={R,G,B} | m:u=u");
	check("R;G;B;Px;Py;Pz;Nsx;Nsy;Nsz", automatic, GD_NAMES_PBRT,
	      "m:N=Ns{x,y,z}* | m:P=P{x,y,z}* | m:={R,G,B}");
}

static void test_cycles(void **state)
{
	(void)state;
	check("View Layer.A.Combined.R;View Layer.A.Combined.G;View Layer.A.Combined.B;View "
	      "Layer.A.Combined.A;"
	      "View Layer.A.Noisy Image.R;View Layer.A.Noisy Image.G;View Layer.A.Noisy Image.B;"
	      "View Layer.A.Denoising Albedo.R;View Layer.A.Denoising Albedo.G;View "
	      "Layer.A.Denoising Albedo.B;"
	      "View Layer.A.Denoising Normal.X;View Layer.A.Denoising Normal.Y;View "
	      "Layer.A.Denoising Normal.Z;"
	      "View Layer.A.Denoising Depth.Z;View Layer.A.Debug Sample Count.X;View "
	      "Layer.A.CryptoObject00.r;"
	      "View Layer.A.IndexOB.X;View Layer.A.Diffuse.R",
	      automatic, GD_NAMES_CYCLES,
	      "m:=View Layer.A.Noisy Image.{R,G,B}* | m:A=View Layer.A.Combined.A* | "
	      "m:albedo=View Layer.A.Denoising Albedo.{R,G,B}* | m:N=View Layer.A.Denoising "
	      "Normal.{X,Y,Z}* | "
	      "m:Z=View Layer.A.Denoising Depth.Z* | s:samples=View Layer.A.Debug Sample Count.X* "
	      "| "
	      "m:View Layer.A.Combined=View Layer.A.Combined.{R,G,B} | "
	      "p:View Layer.A.CryptoObject00=View Layer.A.CryptoObject00.r | p:View "
	      "Layer.A.IndexOB=View Layer.A.IndexOB.X | "
	      "m:View Layer.A.Diffuse=View Layer.A.Diffuse.R");
}

static void test_mitsuba(void **state)
{
	(void)state;
	check("alb.R;alb.G;alb.B;dd.T;img.R;img.G;img.B;m2_alb.R;m2_alb.G;m2_alb.B;m2_img.R;m2_img."
	      "G;m2_img.B;nn.X;nn.Y;nn.Z;"
	      "pos.X;pos.Y;pos.Z",
	      automatic, GD_NAMES_MITSUBA,
	      "m:albedo=alb.{R,G,B}* | m:Z=dd.T* | m:=img.{R,G,B}* | m:N=nn.{X,Y,Z}* | "
	      "m:P=pos.{X,Y,Z}* | "
	      "v:albedo=m2_alb.{R,G,B}* | v:=m2_img.{R,G,B}*");
}

static void test_other_renderers(void **state)
{
	struct gd_names_conf conf = { 0 };

	(void)state;
	check("Ci.r;Ci.g;Ci.b;mse.r;mse.g;mse.b;albedo.r;albedo.g;albedo.b;albedo_var.r;albedo_var."
	      "g;albedo_var.b;normal.r;"
	      "normal.g;normal.b;zfiltered;zfiltered_var;sampleCount",
	      automatic, GD_NAMES_RENDERMAN,
	      "m:=Ci.{r,g,b}* | v:=mse.{r,g,b}* | m:albedo=albedo.{r,g,b}* | "
	      "v:albedo=albedo_var.{r,g,b}* | "
	      "m:N=normal.{r,g,b}* | m:Z=zfiltered* | v:Z=zfiltered_var* | s:samples=sampleCount*");
	check("R;G;B;A;variance.R;variance.G;variance.B;diffuse_albedo.R;diffuse_albedo.G;diffuse_"
	      "albedo.B;N.X;N.Y;N.Z;Z",
	      automatic, GD_NAMES_ARNOLD,
	      "v:=variance.{R,G,B} | m:albedo=diffuse_albedo.{R,G,B}* | m:N=N.{X,Y,Z} | m:={R,G,B} "
	      "| m:Z=Z | m:A=A");
	conf.preset = GD_NAMES_TUNGSTEN;
	check("color.R;color.G;color.B;colorVariance.R;colorVariance.G;colorVariance.B;colorA.R;"
	      "colorA.G;colorA.B;depth",
	      conf, GD_NAMES_TUNGSTEN,
	      "m:=color.{R,G,B}* | v:=colorVariance.{R,G,B}* | m:half0=colorA.{R,G,B}* | "
	      "m:Z=depth*");
}

/* Grey becomes three equal channels, and common words for features are understood. */
static void test_guesses(void **state)
{
	(void)state;
	check("Y;Normal.X;Normal.Y;Normal.Z;depth.Z;#id", automatic, GD_NAMES_GD,
	      "m:=Y* | m:N=Normal.{X,Y,Z}* | m:Z=depth.Z* | p:id=id");
	check("R;G;B;depth;Z", automatic, GD_NAMES_GD, "m:={R,G,B} | m:Z=Z | m:depth=depth");
}

static void test_map(void **state)
{
	const char *map[] = {"albedo=Denoising Albedo.{R,G,B}", "Z=d\\,x", "variance=v",
			     "colour=r1,g1,b1"};
	const char *pass[] = { "mask*" };
	struct gd_names_conf conf = { .nmap = 4, .map = map, .npass = 1, .pass = pass };

	(void)state;
	check("Denoising Albedo.R;Denoising Albedo.G;Denoising "
	      "Albedo.B;albedo.R;d,x;v.R;v.G;v.B;r1;g1;b1;mask1",
	      conf, GD_NAMES_CYCLES,
	      "m:albedo=Denoising Albedo.{R,G,B}* | m:Z=d,x* | v:=v.{R,G,B}* | m:={r1,g1,b1}* | "
	      "d:albedo=albedo.R | "
	      "p:mask1=mask1");
}

static void test_bad_maps(void **state)
{
	static const struct { const char *map, *text; int code;
	} bad[] = {
		{"albedo", "--map 'albedo': wanted is LAYER=CHANNEL or LAYER=NAME.{R,G,B}",
		 GD_EARG},
		{"albedo=", "--map 'albedo=': wanted is LAYER=CHANNEL or LAYER=NAME.{R,G,B}",
		 GD_EARG},
		{"a=b,c", "--map 'a=b,c': wanted is LAYER=CHANNEL or LAYER=NAME.{R,G,B}", GD_EARG},
		{"a=x.{R,G", "--map 'a=x.{R,G': wanted is LAYER=CHANNEL or LAYER=NAME.{R,G,B}",
		 GD_EARG},
		{"albedo=x.{R,G,B}", "no channel x.R (--map albedo=x.{R,G,B})", GD_ESHAPE},
		{"Z=depth", "no channel depth (--map Z=depth)", GD_ESHAPE},
	};
	struct gd_image im;

	(void)state;
	image_of(&im, "R;G;B");
	for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
		struct gd_names_conf conf = { .nmap = 1, .map = &bad[i].map };
		struct gd_names names = { 0 };
		struct gd_err err = { 0 };

		assert_int_equal(gd_names_resolve(&names, &im, &conf, &err), bad[i].code);
		assert_string_equal(err.text, bad[i].text);
		assert_null(names.layer);
	}
	gd_image_free(&im);
}

static void test_sample_counts(void **state)
{
	struct gd_image im;
	double spp = 0;

	(void)state;
	image_of(&im, "R");
	assert_false(gd_names_spp(&im, &spp));
	gd_attr_set_string(&im, "cycles.View Layer.samples", "128", NULL);
	assert_true(gd_names_spp(&im, &spp) && spp == 128);
	gd_attr_set_int(&im, "samplesPerPixel", 16, NULL);
	assert_true(gd_names_spp(&im, &spp) && spp == 16);
	gd_attr_set_number(&im, "gd:samplesPerPixel", 2.5, NULL);
	assert_true(gd_names_spp(&im, &spp) && spp == 2.5);
	gd_image_free(&im);
}

static void test_words(void **state)
{
	enum gd_preset p;
	enum gd_variance v;

	(void)state;
	assert_true(gd_preset_parse("noice", &p) && p == GD_NAMES_ARNOLD);
	assert_true(gd_variance_parse("m2", &v) && v == GD_VARIANCE_M2);
	assert_false(gd_preset_parse("blender", &p));
	assert_string_equal(gd_preset_name(GD_NAMES_CYCLES), "cycles");
	assert_string_equal(gd_variance_name(GD_VARIANCE_SAMPLE), "sample");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_own_names),
		cmocka_unit_test(test_pbrt),
		cmocka_unit_test(test_cycles),
		cmocka_unit_test(test_mitsuba),
		cmocka_unit_test(test_other_renderers),
		cmocka_unit_test(test_guesses),
		cmocka_unit_test(test_map),
		cmocka_unit_test(test_bad_maps),
		cmocka_unit_test(test_sample_counts),
		cmocka_unit_test(test_words),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
