# Every target sets up .venv first if pyproject.toml is newer. Any Python >= 3.11 will do: make PYTHON=python3.12 ...
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.DEFAULT_GOAL := help
.PHONY: help setup demo test check bench golden fuzz soak install uninstall clean

help:  ## this list
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

$(STAMP): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "swingd needs Python 3.11 or newer, this is " + sys.version)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

setup: $(STAMP)  ## create .venv with swingd and everything its tests need

demo: $(STAMP)  ## fly a simulated PX4 with a slung load, correction off, then on
	@mkdir -p out
	$(BIN)/swingd demo -c configs/demo.yaml -o out/demo.png

# Bytecode is kept even where the environment says otherwise: else every process of the tests compiles all modules anew.
test: export PYTHONDONTWRITEBYTECODE :=
# Files go out in the alphabet's order: by xdist's own, the long ones come last and one worker waits. What runs in real
# time shares hardly a fixture, but one file of it would keep a worker busy for a minute: test by test.
SHARED := --dist loadfile --no-loadscope-reorder
LIVE := --dist worksteal
# Only the files that have a mark: each worker needs seconds to read all of them.
marked = $$(grep -rlF --include='test_*.py' mark.$(1) tests)
test: $(STAMP)  ## the whole test suite: in virtual time on all cores, in real time three at a time, long flights two at a time, what must not be late alone
	$(BIN)/python tests/compile_kernels.py
	$(BIN)/python -m pytest -n auto $(SHARED) -m "not live"
	$(BIN)/python -m pytest -n 3 $(LIVE) -m "live and not long and not alone" $(call marked,live)
	$(BIN)/python -m pytest -n 2 $(SHARED) -m long $(call marked,long)
	$(BIN)/python -m pytest -m alone $(call marked,alone)

check: $(STAMP)  ## style, types and the contract of the rooms
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(STAMP)  ## speed of the parts, each as a ratio to a peer of the same run
	$(BIN)/python -m tools.bench

golden: $(STAMP)  ## rewrite the golden replays; read the diff before committing it
	$(BIN)/python -m tools.golden --write

SECONDS ?= 60
TARGET ?= all
fuzz: $(STAMP)  ## feed what reads bytes of others with ever new ones: make fuzz SECONDS=600 TARGET=ulog
	@$(BIN)/python -c 'import atheris' 2> /dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[fuzz]'
	$(BIN)/python -m tools.fuzz $(TARGET) --seconds $(SECONDS)

HOURS ?= 24
soak: $(STAMP)  ## fly simulated hours with everything that goes wrong, in all cores: make soak HOURS=1
	$(BIN)/python -m tools.soak --hours $(HOURS)

# The service. DESTDIR stages for a package: nothing outside of it is touched, nothing is compiled. VENV_READY names an
# environment that has swingd already; else one is made in PREFIX.
DESTDIR ?=
PREFIX ?= /opt/swingd
VENV_READY ?=
SERVICE_VENV = $(or $(VENV_READY),$(PREFIX)/venv)
EXAMPLES = $(PREFIX)/share/swingd.service.d.examples
UNITS := /usr/local/lib/systemd/system
SYSUSERS := /usr/local/lib/sysusers.d
CONFIGURATION := /etc/swingd/swingd.yaml
CACHE := /var/cache/swingd

define CHECK_PATHS
@case '$(PREFIX)' in /?*) ;; *) echo "PREFIX: '$(PREFIX)'; expected an absolute path below /" >&2; exit 2;; esac
@case '$(DESTDIR)' in ''|/?*) ;; *) echo "DESTDIR: '$(DESTDIR)'; expected an absolute path below /, or nothing" >&2; exit 2;; esac
endef

define CHECK_VENV
@case '$(VENV_READY)' in /?*) ;; *) echo "VENV_READY: '$(VENV_READY)'; expected an absolute path, units name the command by it" >&2; exit 2;; esac
@test -x '$(DESTDIR)$(VENV_READY)/bin/swingd' || test -x '$(VENV_READY)/bin/swingd' || { \
	echo "VENV_READY: '$(VENV_READY)' has no command bin/swingd; expected an environment that swingd is installed in" >&2; exit 2; }
endef

install:  ## as a service, below DESTDIR if it is given; see docs/service.md
	$(CHECK_PATHS)
ifneq ($(VENV_READY),)
	$(CHECK_VENV)
ifeq ($(DESTDIR),)
	@'$(VENV_READY)/bin/python' -c 'import os, sys; p = [p for p in map(os.path.realpath, (sys.prefix, sys.base_prefix)) if p.startswith(("/home/", "/root/"))]; sys.exit(f"VENV_READY: {p[0]} lies in a home folder, which the service does not see; expected one of the system" if p else 0)'
	@'$(VENV_READY)/bin/swingd' --version > /dev/null
endif
endif
ifeq ($(VENV_READY),)
	@$(PYTHON) -c 'import os, sys; p = os.path.realpath(sys.base_prefix); sys.exit(f"PYTHON: {p} lies in a home folder, which the service does not see; expected one of the system" if p.startswith(("/home/", "/root/")) else 0)'
	@# For the service's user to read, whatever root's umask; built from a copy, so that no file of root's stays here.
	umask 022 && $(PYTHON) -m venv '$(DESTDIR)$(PREFIX)/venv' \
		&& copy=$$(mktemp -d) && trap 'rm -rf "$$copy"' EXIT && cp -r swingd pyproject.toml README.md LICENSE "$$copy" \
		&& '$(DESTDIR)$(PREFIX)/venv/bin/python' -m pip install --quiet --disable-pip-version-check "$$copy"
	@# The commands name their interpreter by its path.
	cd '$(DESTDIR)$(PREFIX)/venv' && grep -rlIF '$(DESTDIR)$(PREFIX)' bin pyvenv.cfg | xargs -r sed -i 's|$(DESTDIR)$(PREFIX)/venv|$(PREFIX)/venv|g'
endif
	install -d '$(DESTDIR)$(UNITS)' '$(DESTDIR)$(SYSUSERS)' '$(DESTDIR)$(EXAMPLES)' '$(DESTDIR)$(dir $(CONFIGURATION))'
	for unit in swingd.service swingd@.service; do \
		sed 's|/opt/swingd/venv|$(SERVICE_VENV)|' systemd/$$unit > '$(DESTDIR)$(UNITS)'/$$unit || exit; \
		chmod 644 '$(DESTDIR)$(UNITS)'/$$unit; \
	done
	install -m 644 systemd/swingd.sysusers.conf '$(DESTDIR)$(SYSUSERS)/swingd.conf'
	install -m 644 systemd/swingd.service.d.examples/*.conf '$(DESTDIR)$(EXAMPLES)'
	test -e '$(DESTDIR)$(CONFIGURATION)' || install -m 644 configs/x500.yaml '$(DESTDIR)$(CONFIGURATION)'
ifeq ($(DESTDIR),)
	if command -v systemd-sysusers > /dev/null; then systemd-sysusers $(SYSUSERS)/swingd.conf; fi
	if test -d /run/systemd/system; then systemctl daemon-reload; fi
	if id swingd > /dev/null 2>&1; then \
		install -d -m 750 -o swingd -g swingd $(CACHE) && echo 'compiling the filter' \
		&& runuser -u swingd -- env -C / NUMBA_CACHE_DIR=$(CACHE) XDG_CACHE_HOME=$(dir $(CACHE)) '$(SERVICE_VENV)/bin/python' -c 'import swingd.pipeline'; \
	else echo 'there is no user swingd: its first start compiles the filter'; fi
endif

uninstall:  ## remove what install made; configuration, state and user stay
	$(CHECK_PATHS)
ifeq ($(DESTDIR),)
	if test -d /run/systemd/system; then \
		systemctl stop swingd.service 'swingd@*.service'; systemctl disable swingd.service swingd@.service; fi
endif
	rm -f '$(DESTDIR)$(UNITS)/swingd.service' '$(DESTDIR)$(UNITS)/swingd@.service' '$(DESTDIR)$(SYSUSERS)/swingd.conf'
	rm -rf '$(DESTDIR)$(EXAMPLES)' '$(DESTDIR)$(CACHE)'
ifeq ($(VENV_READY),)
	rm -rf '$(DESTDIR)$(PREFIX)/venv'
endif
	for folder in '$(DESTDIR)$(PREFIX)/share' '$(DESTDIR)$(PREFIX)'; do \
		if test -d "$$folder"; then rmdir --ignore-fail-on-non-empty "$$folder"; fi; \
	done
ifeq ($(DESTDIR),)
	if test -d /run/systemd/system; then systemctl daemon-reload; fi
endif

clean:  ## remove what the other targets made
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis build out *.egg-info
