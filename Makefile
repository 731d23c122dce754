# make            the tools into bin/ (with the OpenImageIO/OpenColorIO plug-in where those are installed)
# make core       the tools alone: needs OpenEXR's C library only
# make deps       installs what is missing (Debian)
# make test       every test, and again under the sanitizers
# make demo       builds, runs the main job on real samples, leaves pictures and a table in demo/
# make bench      speed and speed against error
# make install uninstall PREFIX=/usr/local DESTDIR=
PREFIX ?= /usr/local
CC ?= cc
CXX ?= c++
CFLAGS ?= -O2 -g
CXXFLAGS ?= -O2 -g
SAN ?=
O ?= build/$(if $(SAN),san,opt)
B ?= $(if $(SAN),$(O)/bin,bin)

ARCH := $(shell $(CC) -dumpmachine)
EXR_CFLAGS := $(shell pkg-config --cflags OpenEXR)
WARN := -Wall -Wextra -Wshadow -Wconversion -Wno-sign-conversion -Wstrict-prototypes -Wmissing-prototypes
OWN := -std=gnu11 -fopenmp -D_GNU_SOURCE -Ilib $(EXR_CFLAGS) $(WARN) -ffp-contract=off -fno-math-errno $(if $(SAN),-fsanitize=$(SAN) -fno-omit-frame-pointer -fno-sanitize-recover=all) $(EXTRA)
KERN := -O3 -ffp-contract=fast -fno-math-errno -fno-trapping-math
LIBS := $(shell pkg-config --libs-only-L OpenEXR) -lOpenEXRCore-3_1 -lz -lm -ldl -lpthread
PLUGDIR ?= $(PREFIX)/lib/gd

ISA := base $(if $(filter x86_64%,$(ARCH)),v3 v4)
MARCH_base :=
MARCH_v3 := -march=x86-64-v3
MARCH_v4 := -march=x86-64-v4 -mprefer-vector-width=512

TOOLS := $(patsubst cmd/%.c,%,$(wildcard cmd/gd*.c))
BINS := $(TOOLS:%=$(B)/%)
LIBC := $(filter-out lib/cli.c,$(wildcard lib/*.c))
KERNELS := $(wildcard lib/kernel/*.c)
LIBO := $(LIBC:lib/%.c=$(O)/%.o) $(foreach i,$(ISA),$(KERNELS:lib/kernel/%.c=$(O)/%.$i.o))

all: core plugin

core: $(BINS)

$(B)/%: $(O)/cmd/%.o $(O)/cli.o $(O)/libgd.a
	@mkdir -p $(@D)
	$(CC) $(CFLAGS) $(OWN) $(LDFLAGS) -o $@ $^ $(LIBS)

$(O)/libgd.a: $(LIBO)
	@rm -f $@
	$(AR) rcs $@ $^

$(O)/cmd/%.o: cmd/%.c
	@mkdir -p $(@D)
	$(CC) $(CFLAGS) $(OWN) -MMD -MP -c -o $@ $<

$(O)/%.o: lib/%.c
	@mkdir -p $(@D)
	$(CC) $(CFLAGS) $(OWN) -DGD_PLUGDIR='"$(PLUGDIR)"' -MMD -MP -c -o $@ $<

define kernel_rule
$(O)/%.$1.o: lib/kernel/%.c
	@mkdir -p $$(@D)
	$(CC) $(CFLAGS) $(OWN) $(KERN) $(MARCH_$1) -DGD_ISA=_$1 -MMD -MP -c -o $$@ $$<
endef
$(foreach i,$(ISA),$(eval $(call kernel_rule,$i)))

# Needs nothing of libgd.a, so that nothing there has to be position-independent.
PLUGPKG := OpenImageIO OpenColorIO
ifeq ($(shell pkg-config --exists $(PLUGPKG) && echo yes),yes)
plugin: $(B)/gd-plugin.so

$(B)/gd-plugin.so: lib/plugin/shim.cpp lib/plugin/shim.h lib/gd.h
	@mkdir -p $(@D)
	$(CXX) -std=c++17 $(CXXFLAGS) -Ilib -Wall -Wextra -Wshadow -fPIC -shared -fvisibility=hidden \
		$(shell pkg-config --cflags $(PLUGPKG)) $(LDFLAGS) -o $@ $< $(shell pkg-config --libs $(PLUGPKG))
else
plugin:
	@echo "note: without OpenImageIO and OpenColorIO there is no gd-plugin.so: no PNG, no DWA, no display transforms (make deps)"
endif

clean:
	rm -rf build bin demo

.PHONY: all core plugin clean
.SECONDARY:
-include $(shell find $(O) -name '*.d' 2>/dev/null)
