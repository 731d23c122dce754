/* SPDX-License-Identifier: BSD-3-Clause */
/* A table of numbers, as text for people, as TSV and as JSON. */
#ifndef GD_TABLE_H
#define GD_TABLE_H

#include <stdio.h>

#include "gd.h"

#define GD_TABLE_COLUMNS 40

/* NaN is "no value": "-" in text, NA in TSV, null in JSON. */
struct gd_column {
	const char *name;	/* in TSV and JSON; lives as long as the table */
	const char *heading;	/* in text; NULL: not shown there */
};

struct gd_row {
	const char *name;
	double value[GD_TABLE_COLUMNS];
};

/* What holds for the whole table: a column of equal values in TSV, a member of the JSON object. */
struct gd_remark {
	const char *name;
	const char *text;	/* as it is in TSV */
	int bare;		/* JSON: the text is a number or a truth value, not a string */
};

struct gd_table {
	const char *row_heading;	/* "image": of the names of the rows */
	const char *rows_name;		/* "images": the JSON array of the rows */
	int ncolumn, nrow, nremark;
	struct gd_column column[GD_TABLE_COLUMNS];
	struct gd_row *row;
	const struct gd_remark *remark;
};

void gd_table_text(FILE *out, const struct gd_table *t);
void gd_table_tsv(FILE *out, const struct gd_table *t);
/* One object; GD_ENOMEM. */
int gd_table_json(FILE *out, const struct gd_table *t, struct gd_err *err);

#endif
