# Every target sets up .venv first if pyproject.toml is newer. Any Python >= 3.11 will do: make PYTHON=python3.12 ...
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.DEFAULT_GOAL := help
.PHONY: help setup demo test check bench golden clean

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
# Files go out in the alphabet's order: by xdist's own, the long ones come last and one worker waits.
SHARED := --dist loadfile --no-loadscope-reorder
test: $(STAMP)  ## the whole test suite: in virtual time on all cores, in real time three at a time, what must not be late alone
	$(BIN)/python -m pytest -n auto $(SHARED) -m "not live"
	$(BIN)/python -m pytest -n 3 $(SHARED) -m "live and not alone"
	$(BIN)/python -m pytest -m alone

check: $(STAMP)  ## style, types and the contract of the rooms
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(STAMP)  ## speed of the parts, each as a ratio to a peer of the same run
	$(BIN)/python -m tools.bench

golden: $(STAMP)  ## rewrite the golden replays; read the diff before committing it
	$(BIN)/python -m tools.golden --write

clean:  ## remove what the other targets made
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis build out *.egg-info
