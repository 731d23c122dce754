/* SPDX-License-Identifier: BSD-3-Clause */
#include "table.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "json.h"

void gd_table_text(FILE *out, const struct gd_table *t)
{
	int wide = (int)strlen(t->row_heading);

	for (int i = 0; i < t->nrow; i++)
		if ((int)strlen(t->row[i].name) > wide)
			wide = (int)strlen(t->row[i].name);
	fprintf(out, "%-*s", wide, t->row_heading);
	for (int k = 0; k < t->ncolumn; k++)
		if (t->column[k].heading)
			fprintf(out, " %10s", t->column[k].heading);
	fputc('\n', out);
	for (int i = 0; i < t->nrow; i++) {
		fprintf(out, "%-*s", wide, t->row[i].name);
		for (int k = 0; k < t->ncolumn; k++)
			if (t->column[k].heading && isnan(t->row[i].value[k]))
				fprintf(out, " %10s", "-");
			else if (t->column[k].heading)
				fprintf(out, " %10.5g", t->row[i].value[k]);
		fputc('\n', out);
	}
}

void gd_table_tsv(FILE *out, const struct gd_table *t)
{
	fputs(t->row_heading, out);
	for (int k = 0; k < t->ncolumn; k++)
		fprintf(out, "\t%s", t->column[k].name);
	for (int k = 0; k < t->nremark; k++)
		fprintf(out, "\t%s", t->remark[k].name);
	fputc('\n', out);
	for (int i = 0; i < t->nrow; i++) {
		for (const char *p = t->row[i].name; *p; p++)
			fputc(*p == '\t' || *p == '\n' ? ' ' : *p, out);
		for (int k = 0; k < t->ncolumn; k++)
			if (isnan(t->row[i].value[k]))
				fputs("\tNA", out);
			else
				fprintf(out, "\t%.9g", t->row[i].value[k]);
		for (int k = 0; k < t->nremark; k++)
			fprintf(out, "\t%s", t->remark[k].text);
		fputc('\n', out);
	}
}

/* "name": text, quoted unless bare. */
static int member(FILE *out, const char *name, const char *text, int bare)
{
	char *key = gd_json_string(name), *value = bare ? NULL : gd_json_string(text);
	int bad = !key || (!bare && !value);

	if (!bad)
		fprintf(out, "%s: %s", key, bare ? text : value);
	free(key);
	free(value);
	return bad;
}

static int json_row(FILE *out, const struct gd_table *t, const struct gd_row *row)
{
	int bad;

	fputs("    {", out);
	bad = member(out, t->row_heading, row->name, 0);
	for (int k = 0; k < t->ncolumn; k++) {
		char text[32];

		gd_json_number(text, row->value[k]);
		fputs(", ", out);
		bad |= member(out, t->column[k].name, text, 1);
	}
	fputc('}', out);
	return bad;
}

int gd_table_json(FILE *out, const struct gd_table *t, struct gd_err *err)
{
	int bad = 0;

	fputs("{\n", out);
	for (int k = 0; k < t->nremark; k++) {
		fputs("  ", out);
		bad |= member(out, t->remark[k].name, t->remark[k].text, t->remark[k].bare);
		fputs(",\n", out);
	}
	fprintf(out, "  \"%s\": [\n", t->rows_name);
	for (int i = 0; i < t->nrow; i++) {
		bad |= json_row(out, t, &t->row[i]);
		fputs(i + 1 < t->nrow ? ",\n" : "\n", out);
	}
	fputs("  ]\n}\n", out);
	return bad ? gd_fail(err, GD_ENOMEM, "out of memory") : GD_OK;
}
