# Every target works from a fresh clone: it makes .venv first, and again whenever a dependency changes.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test lint fuzz bench docs pages tutorial package clean

demo: .venv/core
	$(BIN)/pendulum-ident demo

# What runs against the clock mostly waits, so that it runs beside what only computes, which makes way for it. What the
# pages show must come out with the kernels of another processor, too: a quick one's here, an old one's in `kernels`.
test: lint
	$(MAKE) --no-print-directory --keep-going --jobs=2 computing realtime
	$(MAKE) --no-print-directory kernels

.PHONY: computing realtime kernels
computing: .venv/dev
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 nice $(BIN)/pytest -n 2 --dist loadfile -m "not realtime"

realtime: .venv/dev
	$(BIN)/pytest -q -m realtime

kernels: .venv/dev
	OPENBLAS_CORETYPE=Prescott OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
		$(BIN)/pytest -q -n 2 --dist worksteal tests/test_documents.py tests/test_tutorial.py -k "workflow or page_runs or tutorial"

lint: .venv/dev
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy

# Files and requests that nobody meant, for MINUTES; what is found is kept in tests/corpus, which the tests read.
MINUTES ?= 60
fuzz: .venv/dev
	OMP_NUM_THREADS=1 nice $(BIN)/python -m tests.fuzzing --minutes $(MINUTES)

bench: .venv/dev
	$(BIN)/python -m benchmarks

docs: .venv/dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Runs what README, docs/ and the tutorial show, and puts in what is printed now; `git diff` shows what changed.
pages: tutorial
	$(BIN)/python -m tests.refresh
	$(BIN)/python -m tests.pictures

# Runs the tutorial notebook and stores what comes out in it.
tutorial: .venv/dev
	$(BIN)/python examples/execute.py

# Builds wheel and sdist into dist/, installs the wheel alone in a fresh environment, and tries it there as a user would.
package: .venv/dev
	rm -rf dist build/package
	$(BIN)/python -m build --outdir dist
	$(BIN)/python -m venv build/package/venv
	build/package/venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
		"$$(ls dist/*.whl)[app]"
	cd build/package && venv/bin/python -I ../../tests/installed.py

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
