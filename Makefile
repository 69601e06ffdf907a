# Every target sets up what it needs: `make bake` and `make test` work on a fresh clone.
PYTHON ?= python3
SET ?= data/sets/grooved-record
OUT ?= out
LIB ?= data/sets
SCENE ?= data/scenes/close-up.toml
OPTIONS ?=
WORKERS ?= 2
VENV := .venv
BIN := $(VENV)/bin
export OPENBLAS_NUM_THREADS ?= 1

ENV ?= procedural
TRAIN ?= data/sets/*/
HELD_OUT ?=
.PHONY: learn probe
.PHONY: help install data bake library compare tradeoff plan view picture test test-slow bench bench-full lint clean
.DELETE_ON_ERROR:

help:
	@echo "make bake [SET=folder] [OUT=out] [OPTIONS=...]  bake a texture set and show the picture"
	@echo "make library [LIB=folder] [OUT=out]             bake every texture set below a folder, with an index page"
	@echo "make data        make the shipped texture sets in data/sets"
	@echo "make tradeoff    [SETS=\"folder ...\"]  what accuracy costs in time: tradeoff/tradeoff.png"
	@echo "make compare     [SETS=\"folder ...\"]  every method against the reference, on the shipped sets: report/index.html"
	@echo "make learn       [TRAIN=\"folder ...\"] [HELD_OUT=\"folder ...\"]  weights of learned, latent and mipnet: out/weights"
	@echo "make probe       [ENV=file] [OUT=out] [OPTIONS=...]  filter an environment into a reflection probe: out/probes"
	@echo "make plan        [SCENE=file.toml]  what a scene calls for, and what it costs"
	@echo "make test        the quick tests, on WORKERS=2 processes; make test-slow runs those that take long"
	@echo "make bench       speed and accuracy, the short way; make bench-full takes its time"
	@echo "make lint        ruff and mypy"
	@echo "make picture     draw the pictures of the README anew: docs/preview.png and docs/tradeoff.png"
	@echo "make install     the environment in $(VENV), with the command $(BIN)/brdffit"
	@echo "make clean       remove the environment and all that was made"

install: $(VENV)/installed

# Its age is that of what it was made from: a changed list of dependencies installs again.
$(VENV)/installed: setup.cfg pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "brdffit needs Python 3.11 or later: make PYTHON=python3.11")'
	@echo "Setting up the environment in $(VENV): a few minutes, once."
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $@

data: data/sets/made

data/sets/made: $(wildcard data/*.toml) brdffit/textures/procedural.py brdffit/textures/generators.py | $(VENV)/installed
	$(BIN)/python -m brdffit.textures.procedural data/sets
	touch $@

# A set of the user's own needs none of ours.
bake: install $(if $(filter data/sets/%,$(SET)),data/sets/made)
	$(BIN)/brdffit bake "$(SET)" -o "$(OUT)" --show $(OPTIONS)

view: install $(if $(filter data/sets/%,$(SET)),data/sets/made)
	$(BIN)/brdffit view "$(SET)" -o "$(OUT)/view.html" --open $(OPTIONS)

compare: data/sets/made
	$(BIN)/brdffit compare $(or $(SETS),data/sets/*/) -o report $(OPTIONS)

tradeoff: data/sets/made
	$(BIN)/brdffit tradeoff $(or $(SETS),data/sets/*/) -o tradeoff $(OPTIONS)

# The shipped weights were made so, from CC0 sets with four held out. Of one core: 2.5 minutes, most of it to make the
# data, 2 minutes, and 50 minutes.
learn: data/sets/made
	$(BIN)/brdffit learn learned $(TRAIN) $(HELD_OUT:%=--held-out %) -o out/weights/learned-ggx.npz --steps 1200
	$(BIN)/brdffit learn mipnet $(TRAIN) $(HELD_OUT:%=--held-out %) -o out/weights/mipnet-ggx.npz --steps 20000
	$(BIN)/brdffit learn latent $(TRAIN) $(HELD_OUT:%=--held-out %) -o out/weights/latent.npz --steps 310000

probe: install
	$(BIN)/brdffit probe "$(ENV)" -o "$(OUT)/probes" $(OPTIONS)

plan: data/sets/made
	$(BIN)/brdffit plan "$(SCENE)" -o "$(OUT)/plan.json" $(OPTIONS)

library: install $(if $(filter data/sets%,$(LIB)),data/sets/made)
	$(BIN)/brdffit library "$(LIB)" -o "$(OUT)/library" $(OPTIONS)

picture: data/sets/made
	$(BIN)/brdffit bake data/sets/grooved-record -o out/picture
	mkdir -p docs
	cp out/picture/grooved-record/preview.png docs/preview.png
	$(BIN)/brdffit tradeoff data/sets/hammered-metal -o out/tradeoff --quick
	cp out/tradeoff/tradeoff.png docs/tradeoff.png

# pytest itself fails when no test ran.
test: install
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile $(OPTIONS)

# One long file of laws holds most of the slow tests: both processes share its tests.
test-slow: install
	$(BIN)/python -m pytest -m slow -n $(WORKERS) --dist worksteal $(OPTIONS)

bench: install
	$(BIN)/python -m benchmarks --quick -o bench

bench-full: install
	$(BIN)/python -m benchmarks -o bench

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:
	rm -rf $(VENV) build *.egg-info data/sets data/large out bench report tradeoff .pytest_cache .hypothesis .mypy_cache .ruff_cache
