# The two commands: `make demo` and `make test`. Everything is installed into .venv by the commands themselves.
PYTHON ?= python3
RAYS ?= 1e8
MINUTES ?= 1
VENV := .venv
BIN := $(VENV)/bin
RUNS := $(VENV)/runs
STAMP := $(VENV)/installed

.PHONY: demo test fuzz lint rays kills bench docs site wheel clean help

help:  ## Show the commands
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

$(RUNS): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("beamfield needs Python 3.11 or newer, got " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

# What tests and checks need besides takes minutes to install, and the demo does without.
$(STAMP): $(RUNS)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

demo: $(RUNS)  ## Simulate a robot, calibrate it, show its filter's error before and after
	$(BIN)/beamfield demo

# Byte code is kept, whatever the environment says: without it, collecting the tests takes each worker 24 s instead of 10.
test: export PYTHONDONTWRITEBYTECODE =
test: $(STAMP)  ## Run all tests (three lanes: normal, JIT off, doctests)
	$(BIN)/python -m pytest -n 2 --dist loadfile -q
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -n 2 -q tests/kernels

fuzz: $(STAMP)  ## Feed hostile files to every reader for MINUTES=1, two processes, a fresh seed
	$(BIN)/python -m tests.fuzz --minutes $(MINUTES)

lint: $(STAMP)  ## Check style, types, import direction and spelling
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/codespell

rays: $(STAMP)  ## Compare RAYS=1e8 adversarial rays with an exact traversal
	$(BIN)/python -m tests.rays --rays $(RAYS)

bench: $(STAMP)  ## Measure speed beside baselines and limit, write docs/benchmarks.md and the history of ratios
	$(BIN)/python benchmarks/run.py

kills: $(STAMP)  ## Kill every command that writes, fill its disk, run it twice at once
	$(BIN)/python -m tests.faults

docs: $(STAMP)  ## Redraw the pictures and tables of the documentation
	$(BIN)/python docs/make_figures.py
	$(BIN)/python docs/make_book_map.py

site: $(STAMP)  ## Build the documentation site into site/; it works from file://
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	version=$$($(BIN)/python -c 'import beamfield; print(beamfield.__version__)') && \
	  $(BIN)/sphinx-build --quiet --fail-on-warning --keep-going --doctree-dir build/doctrees --builder html docs site/$$version && \
	  $(BIN)/python docs/make_versions.py site

wheel: $(STAMP)  ## Build the wheel into dist/
	$(BIN)/python -m build --quiet --wheel

clean:  ## Remove what the commands made
	rm -rf $(VENV) dist build site docs/api .pytest_cache .mypy_cache .ruff_cache .hypothesis
