/* SPDX-License-Identifier: BSD-3-Clause */
/* OpenImageIO and OpenColorIO behind plain C functions: no exception passes this border. */
#include "shim.h"

#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include <OpenColorIO/OpenColorIO.h>
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

namespace OCIO = OCIO_NAMESPACE;

namespace {

enum { TYPE_UINT, TYPE_HALF, TYPE_FLOAT };	/* enum gd_type */

int fail(struct gd_err *err, int code, const char *format, ...)
	__attribute__((format(printf, 3, 4)));

int fail(struct gd_err *err, int code, const char *format, ...)
{
	if (err && !err->code) {
		va_list ap;

		va_start(ap, format);
		vsnprintf(err->text, sizeof(err->text), format, ap);
		va_end(ap);
		for (char *p = err->text; *p; p++) /* the libraries' texts may have several lines */
			if (*p == '\n')
				*p = p[1] ? ';' : '\0';
		err->code = code;
	}
	return code;
}

/* Runs f, and turns what it throws into an error. */
template <class F> int guarded(struct gd_err *err, const char *what, F f) noexcept
{
	try {
		return f();
	} catch (const std::bad_alloc &) {
		return fail(err, GD_ENOMEM, "%s: out of memory", what);
	} catch (const std::exception &e) {
		return fail(err, GD_EFORMAT, "%s: %s", what, e.what());
	} catch (...) {
		return fail(err, GD_EFORMAT, "%s: unknown failure", what);
	}
}

struct File {
	std::string path;
	std::unique_ptr<OIIO::Filesystem::IOMemReader> memory;
	std::unique_ptr<OIIO::ImageInput> in;
	OIIO::ImageSpec spec;
	int part = 0;
	bool exr = false, srgb = false;
	std::vector<unsigned char> pixel;	/* as in the file, channels interleaved */
};

OIIO::TypeDesc channel_type(const File &f, int i)
{
	return f.spec.channelformat(i);
}

size_t channel_offset(const File &f, int i)
{
	size_t sum = 0;

	for (int c = 0; c < i; c++)
		sum += channel_type(f, c).size();
	return sum;
}

/* Only EXR has integers that are ids, not shades. */
bool is_id(const File &f, int i)
{
	return f.exr && channel_type(f, i) == OIIO::TypeDesc::UINT32;
}

int type_of(const File &f, int i)
{
	OIIO::TypeDesc t = channel_type(f, i);

	return is_id(f, i) ? TYPE_UINT : t == OIIO::TypeDesc::HALF ? TYPE_HALF : TYPE_FLOAT;
}

void fill_info(struct gd_shim_info *info, const OIIO::ImageSpec &s)
{
	info->x0 = s.x;
	info->y0 = s.y;
	info->x1 = s.x + s.width - 1;
	info->y1 = s.y + s.height - 1;
	info->display_x0 = s.full_x;
	info->display_y0 = s.full_y;
	info->display_x1 = s.full_x + s.full_width - 1;
	info->display_y1 = s.full_y + s.full_height - 1;
	info->nchan = s.nchannels;
	info->nattr = int(s.extra_attribs.size());
}

int open_file(File &f, const void *data, size_t size, struct gd_err *err)
{
	const char *path = f.path.c_str();

	if (data)
		f.memory.reset(new OIIO::Filesystem::IOMemReader(const_cast<void *>(data), size));
	OIIO::ImageSpec hints;
	OIIO::Filesystem::IOProxy *memory = f.memory.get();

	hints.attribute("oiio:UnassociatedAlpha", 1);	/* colour as it is in the file */
	if (memory)	/* some formats look for it here */
		hints.attribute("oiio:ioproxy", OIIO::TypeDesc::PTR, &memory);
	f.in = OIIO::ImageInput::open(f.path, &hints, memory);
	if (!f.in) {
		std::string why = OIIO::geterror();

		return fail(err, GD_EFORMAT, "%s: %s", path,
			    why.empty() ? "not an image file" : why.c_str());
	}
	if (!f.in->seek_subimage(f.part, 0)) {
		f.in->geterror();
		return fail(err, GD_EARG, "%s: no part %d", path, f.part);
	}
	f.spec = f.in->spec();
	f.exr = !strcmp(f.in->format_name(), "openexr");
	f.srgb = !f.exr && f.spec.get_string_attribute("oiio:ColorSpace") == "sRGB" &&
		 !f.spec.format.is_floating_point();
	if (f.spec.deep)
		return fail(err, GD_EFORMAT, "%s: deep pixels are not supported", path);
	if (f.spec.depth > 1)
		return fail(err, GD_EFORMAT, "%s: volumes are not supported", path);
	return GD_OK;
}

int shim_open(void **file, struct gd_shim_info *info, const char *path, const void *data,
	      size_t size, int part, struct gd_err *err) noexcept
{
	*file = nullptr;
	return guarded(err, path, [&] {
		auto f = std::make_unique<File>();

		f->path = path;
		f->part = part;
		int rc = open_file(*f, data, size, err);
		if (rc == GD_OK) {
			fill_info(info, f->spec);
			*file = f.release();
		}
		return rc;
	});
}

const char *shim_channel(void *file, int i, int *type) noexcept
{
	File &f = *static_cast<File *>(file);

	*type = type_of(f, i);
	return f.spec.channelnames[size_t(i)].c_str();
}

int shim_attr(void *file, int i, struct gd_shim_attr *attr) noexcept
{
	File &f = *static_cast<File *>(file);
	const OIIO::ParamValue &p = f.spec.extra_attribs[size_t(i)];

	attr->name = p.name().c_str();
	if (p.type() == OIIO::TypeDesc::INT) {
		attr->type = 'i';
		attr->i = *static_cast<const int *>(p.data());
	} else if (p.type() == OIIO::TypeDesc::FLOAT) {
		attr->type = 'f';
		attr->f = *static_cast<const float *>(p.data());
	} else if (p.type() == OIIO::TypeDesc::STRING) {
		attr->type = 's';
		attr->s = *static_cast<const char *const *>(p.data());
	} else {
		return 0;
	}
	return 1;
}

int shim_load(void *file, struct gd_err *err) noexcept
{
	File &f = *static_cast<File *>(file);

	return guarded(err, f.path.c_str(), [&] {
		f.pixel.resize(size_t(f.spec.width) * size_t(f.spec.height) *
			       f.spec.pixel_bytes(true));
		if (!f.in->read_image(f.part, 0, 0, f.spec.nchannels, OIIO::TypeDesc::UNKNOWN,
				      f.pixel.data())) {
			std::string why = f.in->geterror();

			return fail(err, GD_EFORMAT, "%s: %s", f.path.c_str(),
				    why.empty() ? "cannot be read" : why.c_str());
		}
		return int(GD_OK);
	});
}

float linear(float v)
{
	return v <= 0.04045f ? v / 12.92f : std::pow((v + 0.055f) / 1.055f, 2.4f);
}

void copy_row(void *to, const unsigned char *from, const File &f, int channel, bool as_float)
{
	const int w = f.spec.width;
	const OIIO::TypeDesc type = channel_type(f, channel);
	const OIIO::stride_t step = OIIO::stride_t(f.spec.pixel_bytes(true));

	if (is_id(f, channel) && as_float) {
		for (int x = 0; x < w; x++) {
			unsigned id;

			memcpy(&id, from + x * step, sizeof(id));
			static_cast<float *>(to)[x] = float(id);
		}
		return;
	}
	OIIO::TypeDesc want = type;

	if (as_float || type_of(f, channel) == TYPE_FLOAT)
		want = OIIO::TypeDesc::FLOAT;
	OIIO::convert_image(1, w, 1, 1, from, type, step, OIIO::AutoStride, OIIO::AutoStride, to,
			    want, OIIO::AutoStride, OIIO::AutoStride, OIIO::AutoStride);
	if (f.srgb && channel != f.spec.alpha_channel)
		for (int x = 0; x < w; x++)
			static_cast<float *>(to)[x] = linear(static_cast<float *>(to)[x]);
}

int shim_copy(void *file, int channel, int as_float, void *to, size_t row_bytes,
	      struct gd_err *err) noexcept
{
	File &f = *static_cast<File *>(file);

	return guarded(err, f.path.c_str(), [&] {
		const size_t row = size_t(f.spec.width) * f.spec.pixel_bytes(true);
		const unsigned char *from = f.pixel.data() + channel_offset(f, channel);

		for (int y = 0; y < f.spec.height; y++)
			copy_row(static_cast<char *>(to) + size_t(y) * row_bytes,
				 from + size_t(y) * row, f, channel, as_float != 0);
		return int(GD_OK);
	});
}

void shim_close(void *file) noexcept
{
	try {
		delete static_cast<File *>(file);
	} catch (...) {
	}
}

int shim_png(unsigned char **png, size_t *size, const void *pixel, int w, int h, int n, int bits,
	     struct gd_err *err) noexcept
{
	*png = nullptr;
	return guarded(err, "PNG", [&] {
		OIIO::ImageSpec spec(w, h, n,
				     bits == 16 ? OIIO::TypeDesc::UINT16 : OIIO::TypeDesc::UINT8);
		OIIO::Filesystem::IOVecOutput memory;
		auto out = OIIO::ImageOutput::create("memory.png", &memory);

		if (!out)
			return fail(err, GD_EIO, "PNG: OpenImageIO cannot write it");
		spec.attribute("oiio:ColorSpace", "sRGB");
		if (!out->open("memory.png", spec) || !out->write_image(spec.format, pixel) ||
		    !out->close())
			return fail(err, GD_EIO, "PNG: %s", out->geterror().c_str());
		*size = memory.buffer().size();
		*png = static_cast<unsigned char *>(malloc(*size));
		if (!*png)
			return fail(err, GD_ENOMEM, "PNG: out of memory");
		memcpy(*png, memory.buffer().data(), *size);
		return int(GD_OK);
	});
}

/* For those who have no $OCIO: an sRGB display for scene-linear Rec. 709. */
const char builtin[] =
	"ocio_profile_version: 2\n"
	"search_path: \"\"\n"
	"strictparsing: true\n"
	"roles:\n"
	"  default: linear\n"
	"  scene_linear: linear\n"
	"  data: raw\n"
	"file_rules:\n"
	"  - !<Rule> {name: Default, colorspace: default}\n"
	"displays:\n"
	"  sRGB:\n"
	"    - !<View> {name: Standard, colorspace: srgb}\n"
	"    - !<View> {name: Raw, colorspace: raw}\n"
	"active_displays: [sRGB]\n"
	"active_views: [Standard, Raw]\n"
	"colorspaces:\n"
	"  - !<ColorSpace> {name: linear}\n"
	"  - !<ColorSpace> {name: raw, isdata: true}\n"
	"  - !<ColorSpace>\n"
	"    name: srgb\n"
	"    from_scene_reference: !<ExponentWithLinearTransform> "
	"{gamma: 2.4, offset: 0.055, direction: inverse}\n";

OCIO::ConstConfigRcPtr load_config()
{
	const char *path = getenv("OCIO");

	OCIO::SetLoggingLevel(OCIO::LOGGING_LEVEL_NONE);
	if (path && *path)
		return OCIO::Config::CreateFromFile(path);
	std::istringstream text(builtin);
	return OCIO::Config::CreateFromStream(text);
}

std::string quoted(const std::string &list, const char *name)
{
	return list + (list.empty() ? "\"" : ", \"") + name + "\"";
}

/* Replaces NULL by the default; an unknown name fails with the list of those that exist. */
int choose_view(const OCIO::ConstConfigRcPtr &config, std::string &display, std::string &view,
		struct gd_err *err)
{
	std::string displays, views;
	bool found = false;

	if (display.empty())
		display = config->getDefaultDisplay();
	for (int i = 0; i < config->getNumDisplays(); i++) {
		found = found || display == config->getDisplay(i);
		displays = quoted(displays, config->getDisplay(i));
	}
	if (!found)
		return fail(err, GD_EARG, "no display \"%s\", there is %s", display.c_str(),
			    displays.c_str());
	if (view.empty())
		view = config->getDefaultView(display.c_str());
	found = false;
	for (int i = 0; i < config->getNumViews(display.c_str()); i++) {
		found = found || view == config->getView(display.c_str(), i);
		views = quoted(views, config->getView(display.c_str(), i));
	}
	if (!found)
		return fail(err, GD_EARG, "no view \"%s\" of display \"%s\", there is %s",
			    view.c_str(), display.c_str(), views.c_str());
	return GD_OK;
}

int shim_display(float *rgb, size_t n, const char *display, const char *view,
		 struct gd_err *err) noexcept
{
	return guarded(err, "OpenColorIO", [&] {
		OCIO::ConstConfigRcPtr config = load_config();
		std::string d = display ? display : "", v = view ? view : "";
		int rc = choose_view(config, d, v, err);

		if (rc != GD_OK)
			return rc;
		auto transform = OCIO::DisplayViewTransform::Create();
		transform->setSrc(OCIO::ROLE_SCENE_LINEAR);
		transform->setDisplay(d.c_str());
		transform->setView(v.c_str());
		auto cpu = config->getProcessor(transform)->getDefaultCPUProcessor();
		const size_t piece = 1 << 16;

		for (size_t i = 0; i < n; i += piece) {
			OCIO::PackedImageDesc image(rgb + 3 * i,
						    long(n - i < piece ? n - i : piece), 1, 3);

			cpu->apply(image);
		}
		for (size_t i = 0; i < 3 * n; i++)
			rgb[i] = rgb[i] > 0 ? (rgb[i] < 1 ? rgb[i] : 1) : 0; /* also NaN */
		return rc;
	});
}

} // namespace

extern "C" {
extern const struct gd_shim gd_shim_table __attribute__((visibility("default")));
const struct gd_shim gd_shim_table = {
	GD_SHIM_ABI,
	shim_open,
	shim_channel,
	shim_attr,
	shim_load,
	shim_copy,
	shim_close,
	shim_png,
	shim_display,
};
}
