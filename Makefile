# `make reproduce` regenerates everything, `make test` runs the tests; both set up .venv first. PYTHON is 3.10 or 3.11.
PYTHON ?= $(firstword $(foreach name,python3.11 python3.10 python3,$(if $(shell command -v $(name)),$(name))))
BIN := .venv/bin
export PATH := $(CURDIR)/$(BIN):$(PATH)

.PHONY: setup reproduce test check clean

setup: $(BIN)/.installed

$(BIN)/.installed: pyproject.toml
	$(if $(PYTHON),,$(error no Python found; Python 3.10 or 3.11 is needed, set PYTHON=))
	$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 11) and "Python 3.10 or 3.11 is needed (pybullet); set PYTHON=")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $@

reproduce: setup
	beso check
	beso run -j 2

test: setup check
	python -m pytest

check: setup
	ruff check .
	ruff format --check .
	mypy

clean:
	rm -rf .venv .scratch
