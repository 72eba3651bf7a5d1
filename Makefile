# `make demo` shows the archived policies, `make reproduce` makes everything, `make test` runs the tests. Each sets up
# .venv first. PYTHON is 3.11.
# `beso lock` renews constraints/ from the environment that is installed.
PYTHON ?= $(firstword $(foreach name,python3.11 python3,$(if $(shell command -v $(name)),$(name))))
CONSTRAINTS := constraints/results.txt constraints/tools.txt
BIN := .venv/bin
export PATH := $(CURDIR)/$(BIN):$(PATH)

.PHONY: setup demo reproduce test check clean

setup: $(BIN)/.installed

$(BIN)/.installed: pyproject.toml $(CONSTRAINTS)
	$(if $(PYTHON),,$(error no Python found; Python 3.11 is needed, set PYTHON=))
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11) and "Python 3.11 is needed; set PYTHON=")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet $(addprefix -c ,$(CONSTRAINTS)) --editable '.[dev]'
	touch $@

demo: setup
	beso demo

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
