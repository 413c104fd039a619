# Every target works from a fresh clone: it makes .venv first, and again whenever a dependency changes.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test lint bench docs pages tutorial package clean

demo: .venv/core
	$(BIN)/pendulum-ident demo

# Every module, in 10 to 17 minutes on two cores; PART=estimators/online takes the tests of one folder or file alone.
# What runs against the clock mostly waits, so that it runs beside what only computes, which gives way to it.
PART ?=
HERE := $(if $(PART),tests/$(PART:tests/%=%),tests)
ONE := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
unexport PYTHONDONTWRITEBYTECODE # else every process that a test starts compiles every module anew
test: style
	$(MAKE) --no-print-directory --keep-going --jobs=3 computing realtime types

# What takes longer: statistics over many runs, every drive, and what README, docs/ and the notebooks show: written with
# the kernels of a new processor, it must come out with those of an old one.
test-slow: .venv/dev
	$(MAKE) --no-print-directory --keep-going --jobs=2 computing realtime WHICH="slow and not pages"
	$(MAKE) --no-print-directory shown

.PHONY: test-slow computing realtime shown style types
WHICH ?= not slow
# Files with tests of a kind: to collect all others takes ten seconds a process.
marked = $(shell grep -rl --include='*.py' 'mark\.$(1)' $(HERE))
NONE_THERE = $(if $(PART),|| test $$? = 5)# a part may have no tests of a kind
computing: .venv/dev
	$(ONE) nice -n 4 $(BIN)/pytest -q -n 2 --dist worksteal -m "$(WHICH) and not realtime" $(HERE) $(NONE_THERE)

realtime: .venv/dev
	$(if $(call marked,realtime),$(BIN)/pytest -q -m "$(WHICH) and realtime" $(call marked,realtime) $(NONE_THERE))

shown: .venv/dev
	OPENBLAS_CORETYPE=Prescott $(ONE) $(BIN)/pytest -q -n 2 --dist worksteal -m pages $(call marked,pages)

lint: style types

style: .venv/dev
	$(BIN)/ruff format --check
	$(BIN)/ruff check

types: .venv/dev
	$(BIN)/mypy

bench: .venv/dev
	$(BIN)/python -m benchmarks

docs: .venv/dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Runs what README, docs/ and the notebooks show, and puts in what is printed now; `git diff` shows what changed.
pages: tutorial
	$(BIN)/python -m tools.refresh
	$(BIN)/python -m tools.pictures

# Runs the notebooks of examples/ and stores their outputs in them.
tutorial: .venv/dev
	$(BIN)/python tools/execute.py

# Builds wheel and sdist into dist/, installs the wheel alone in a fresh environment, and tries it there as a user would.
package: .venv/dev
	rm -rf dist build/package
	$(BIN)/python -m build --outdir dist
	$(BIN)/python -m venv build/package/venv
	build/package/venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
		"$$(ls dist/*.whl)[app]"
	cd build/package && venv/bin/python -I ../../tools/installed.py

clean:
	rm -rf .venv build dist .pytest_cache .hypothesis .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamps: what is installed is newer than what asks for it.
.venv/core: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e .
	touch $@

.venv/dev: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e .[dev]
	touch $@ .venv/core

$(BIN)/python:
	$(PYTHON) -m venv .venv
