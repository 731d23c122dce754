# make help lists what can be made.
ifeq ($(findstring -j,$(MAKEFLAGS)),)
MAKEFLAGS += -j$(shell nproc 2>/dev/null || echo 2)
endif
PREFIX ?= /usr/local
CC ?= cc
CXX ?= c++
CFLAGS ?= -O2 -g
CXXFLAGS ?= -O2 -g
SAN ?=
O ?= build/$(if $(SAN),san,opt)
B ?= $(if $(SAN),$(O)/bin,bin)

ARCH := $(shell $(CC) -dumpmachine 2>/dev/null)
EXR_CFLAGS := $(shell pkg-config --cflags OpenEXR 2>/dev/null)
WARN := -Wall -Wextra -Wshadow -Wconversion -Wno-sign-conversion -Wstrict-prototypes -Wmissing-prototypes
OWN := -std=gnu11 -fopenmp -D_GNU_SOURCE -Ilib $(EXR_CFLAGS) $(WARN) -ffp-contract=off -fno-math-errno $(if $(SAN),-fsanitize=$(SAN) -fno-omit-frame-pointer -fno-sanitize-recover=all) $(EXTRA)
KERN := -O3 -ffp-contract=fast -fno-math-errno -fno-trapping-math
LIBS := $(shell pkg-config --libs-only-L OpenEXR 2>/dev/null) -lOpenEXRCore-3_1 -lz -lm -ldl -lpthread
PLUGDIR ?= $(PREFIX)/lib/gd

ISA := base $(if $(filter x86_64%,$(ARCH)),v3 v4)
MARCH_base :=
MARCH_v3 := -march=x86-64-v3
MARCH_v4 := -march=x86-64-v4 -mprefer-vector-width=512

# gdrender needs Embree, assimp and cJSON; without them the other tools are built all the same.
RENDERPKG := assimp libcjson
RENDER := $(shell pkg-config --exists $(RENDERPKG) 2>/dev/null && \
	echo '\#include <embree3/rtcore.h>' | $(CC) -E -x c - >/dev/null 2>&1 && echo yes)
RENDERLIBS := -lembree3 $(shell pkg-config --libs $(RENDERPKG) 2>/dev/null)
RENDERO := $(patsubst lib/%.c,$(O)/%.o,$(wildcard lib/render/*.c))

TOOLS := $(filter-out $(if $(RENDER),,gdrender),$(patsubst cmd/%.c,%,$(wildcard cmd/gd*.c)))
BINS := $(TOOLS:%=$(B)/%)
LIBC := $(filter-out lib/cli.c,$(wildcard lib/*.c))
KERNELS := $(wildcard lib/kernel/*.c)
LIBO := $(LIBC:lib/%.c=$(O)/%.o) $(foreach i,$(ISA),$(KERNELS:lib/kernel/%.c=$(O)/%.$i.o))

all: core plugin
ifneq ($(RENDER),yes)
	@echo "note: without Embree 3, assimp and cJSON there is no gdrender (make deps)"
endif

core: $(BINS)

$(B)/%: $(O)/cmd/%.o $(O)/cli.o $(O)/libgd.a
	@mkdir -p $(@D)
	$(CC) $(CFLAGS) $(OWN) $(LDFLAGS) -o $@ $^ $(LIBS)

$(B)/gdrender: $(O)/cmd/gdrender.o $(O)/cli.o $(O)/libgdrender.a $(O)/libgd.a
	@mkdir -p $(@D)
	$(CC) $(CFLAGS) $(OWN) $(LDFLAGS) -o $@ $^ $(RENDERLIBS) $(LIBS)

$(O)/libgdrender.a: $(RENDERO)
	@rm -f $@
	$(AR) rcs $@ $^

$(O)/render/%.o: lib/render/%.c
	@mkdir -p $(@D)
	$(CC) $(CFLAGS) $(OWN) $(KERN) $(shell pkg-config --cflags $(RENDERPKG) 2>/dev/null) -MMD -MP -c -o $@ $<

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
ifeq ($(shell pkg-config --exists $(PLUGPKG) 2>/dev/null && echo yes),yes)
plugin: $(B)/gd-plugin.so

$(B)/gd-plugin.so: lib/plugin/shim.cpp lib/plugin/shim.h lib/gd.h
	@mkdir -p $(@D)
	$(CXX) -std=c++17 $(CXXFLAGS) -Ilib -Wall -Wextra -Wshadow -fPIC -shared -fvisibility=hidden \
		$(shell pkg-config --cflags $(PLUGPKG)) $(LDFLAGS) -o $@ $< $(shell pkg-config --libs $(PLUGPKG))
else
plugin:
	@echo "note: without OpenImageIO and OpenColorIO there is no gd-plugin.so: no PNG, no DWA, no display transforms (make deps)"
endif

# Test programs, one for each file; tests/support/*.c are tools of the tests.
TESTC := $(wildcard tests/unit/test_*.c tests/num/*.c tests/hard/*.c)
RENDERTESTC := $(if $(RENDER),$(wildcard tests/render/test_*.c))
SUPPORTC := $(wildcard tests/support/*.c)
BENCHC := $(wildcard tests/bench/*.c)
RENDERTESTS := $(RENDERTESTC:%.c=$(O)/%)
TESTS := $(TESTC:%.c=$(O)/%)
SUPPORT := $(SUPPORTC:%.c=$(O)/%)
BENCHES := $(BENCHC:%.c=$(O)/%)
SANITIZERS := address,undefined

$(TESTS): TESTLIBS := -lcmocka
$(TESTS) $(SUPPORT) $(BENCHES): $(O)/%: %.c $(O)/libgd.a
	@mkdir -p $(@D)
	$(CC) $(CFLAGS) $(OWN) -MMD -MP -MF $@.d -o $@ $< $(O)/libgd.a $(LDFLAGS) $(TESTLIBS) $(LIBS)

$(RENDERTESTS): $(O)/%: %.c $(O)/libgdrender.a $(O)/libgd.a
	@mkdir -p $(@D)
	$(CC) $(CFLAGS) $(OWN) -MMD -MP -MF $@.d -o $@ $< $(O)/libgdrender.a $(O)/libgd.a $(LDFLAGS) -lcmocka $(RENDERLIBS) $(LIBS)

tests: core $(TESTS) $(RENDERTESTS) $(SUPPORT)

# Every test, then every test again under the sanitizers; the last line is "N passed, M failed".
test:
	@$(MAKE) --no-print-directory deps
	@$(MAKE) --no-print-directory tests plugin
	@$(MAKE) --no-print-directory SAN=$(SANITIZERS) O=build/san B=build/san/bin tests
	@if [ -f $(B)/gd-plugin.so ]; then cp -p $(B)/gd-plugin.so build/san/bin/; fi
	@tests/run plain:$(O):$(B) san:build/san:build/san/bin

check: tests plugin
	@tests/run plain:$(O):$(B)

# Each header alone, manuals, shell scripts. In bats "! command" never fails a test, nor does a false A in "A && B".
lint:
	@for h in lib/*.h lib/render/*.h; do echo "#include \"$${h#lib/}\"" | \
		$(CC) $(OWN) -x c -fsyntax-only - || { echo "$$h does not stand alone"; exit 1; }; done
	@mandoc -T lint -W warning man/*.[157]
	@shellcheck -x .ci/run tests/run $(wildcard tests/bench/*.sh tests/support/*.sh tests/*.sh examples/*.sh)
	@shellcheck -i SC2314,SC2315 $(wildcard tests/*/*.bats)
	@! grep -nE '^\s+\[.*\] && [^|]*$$' $(wildcard tests/*/*.bats) /dev/null
	@echo "lint: nothing to say"

# What make knows of libraries dates from before deps installed them: hence the second make.
demo:
	@$(MAKE) --no-print-directory deps
	@$(MAKE) --no-print-directory all
	@GD_BIN=$(B) tests/demo.sh testdata demo

# The scenes of testdata are in git; this writes them again.
scenes: $(O)/tests/support/mkscenes
	@mkdir -p testdata/scenes
	@$(O)/tests/support/mkscenes testdata/scenes

# Hours; goes on where it was stopped. SCENES="kitchen door": these alone.
references: all
	@tests/references.sh $(B) testdata/scenes build/references $(SCENES)

# Adaptive rendering of one scene of testdata/scenes; LOOP: options of examples/adaptive.sh.
SCENE ?= kitchen
LOOP ?=
LOOP_SIZE ?= 320x240
loop: all
	@mkdir -p build/loop
	@PATH="$(abspath $(B)):$$PATH" examples/adaptive.sh $(LOOP) testdata/scenes/$(SCENE).gltf build/loop/$(SCENE).exr -- \
		--size $(LOOP_SIZE) $$(cat testdata/scenes/$(SCENE).args)
	@echo "build/loop/$(SCENE).exr: look at it with $(B)/gdshow build/loop/$(SCENE).exr $(SCENE).png"

bench: all $(BENCHES) $(SUPPORT)
	@$(MAKE) --no-print-directory -C tests/bench OBJ=$(abspath $(O)/tests) BIN=$(abspath $(B)) DATA=$(abspath $(or $(DATA),testdata)) \
		OUT=$(abspath build/bench)

DEPS_CORE := gcc libc6-dev make pkg-config libopenexr-dev zlib1g-dev
DEPS := $(DEPS_CORE) g++ libopenimageio-dev libopencolorio-dev libembree-dev libassimp-dev libcjson-dev \
	libcmocka-dev bats mandoc gnuplot-nox
SUDO := $(if $(filter-out 0,$(shell id -u)),sudo)

deps:
	@command -v dpkg-query >/dev/null && command -v apt-get >/dev/null || { \
		echo "not Debian: please install what matches $(DEPS)"; exit 0; }; \
	need=; for p in $(DEPS); do \
		dpkg-query -W -f '$${Status}' $$p 2>/dev/null | grep -q '^install ok' || need="$$need $$p"; done; \
	if [ -z "$$need" ]; then echo "nothing is missing"; else echo "installing$$need"; \
		$(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get update -q && \
		$(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -qy --no-install-recommends $$need; fi

MAN := $(DESTDIR)$(PREFIX)/share/man
PLUGDEST := $(DESTDIR)$(PLUGDIR)

install: all
	install -d $(DESTDIR)$(PREFIX)/bin $(MAN)/man1 $(MAN)/man5 $(MAN)/man7
	install $(BINS) $(DESTDIR)$(PREFIX)/bin
	for s in 1 5 7; do install -m 644 man/*.$$s $(MAN)/man$$s || exit 1; done
	if [ -f $(B)/gd-plugin.so ]; then install -d $(PLUGDEST) && install -m 644 $(B)/gd-plugin.so $(PLUGDEST); fi

uninstall:
	rm -f $(TOOLS:%=$(DESTDIR)$(PREFIX)/bin/%) $(PLUGDEST)/gd-plugin.so
	for s in 1 5 7; do for m in man/*.$$s; do rm -f $(MAN)/man$$s/$${m#man/}; done; done
	-rmdir $(PLUGDEST) 2>/dev/null

clean:
	rm -rf build bin demo

help:
	@echo 'make            the tools into bin/, with the OpenImageIO/OpenColorIO plug-in where those are installed'
	@echo 'make core       the tools alone: needs OpenEXR and zlib only'
	@echo 'make deps       installs what is missing (Debian)'
	@echo 'make demo       the main job on real samples; leaves pictures, a table and a plot in demo/'
	@echo 'make test       every test, and again under the address and undefined-behaviour sanitizers'
	@echo 'make check      every test, without the sanitizers'
	@echo 'make bench      speed, and speed against error, into build/bench/ (DATA=dir: of the scenes there)'
	@echo 'make -C tests/bench render   the same with rendering, on the scenes that have references, into build/bench/render/'
	@echo 'make scenes     writes the scenes of testdata again, after a change to their generator'
	@echo 'make references references of the scenes into build/references: hours, resumable (SCENES REF_SIZE REF_PASSES REF_SPP)'
	@echo 'make loop       renders a scene in passes, each where the one before says (SCENE LOOP LOOP_SIZE)'
	@echo 'make lint       headers, manuals, scripts'
	@echo 'make install uninstall PREFIX=/usr/local DESTDIR='
	@echo 'Variables: CC CFLAGS LDFLAGS CXX CXXFLAGS SAN=address,undefined O=objects B=binaries'

.PHONY: all core plugin tests test check lint demo loop scenes references bench deps install uninstall clean help
.SECONDARY:
-include $(shell find $(O) -name '*.d' 2>/dev/null)
