# Every target works from a fresh clone: it makes .venv first, and again whenever a dependency changes.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test lint bench docs pages tutorial clean

demo: .venv/core
	$(BIN)/pendulum-ident demo

# Two cores share what only computes; what runs against the clock follows alone, and may stumble over a busy machine.
test: lint
	OMP_NUM_THREADS=1 $(BIN)/pytest -n 2 --dist loadfile -m "not realtime"
	$(BIN)/pytest -m realtime --reruns 2 --reruns-delay 1

lint: .venv/dev
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy

bench: .venv/dev
	$(BIN)/python -m benchmarks

docs: .venv/dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Runs what README, docs/ and the tutorial show, and puts in what is printed now; `git diff` shows what changed.
pages: tutorial
	$(BIN)/python -m tests.refresh

# Runs the tutorial notebook and stores what comes out in it.
tutorial: .venv/dev
	$(BIN)/python examples/execute.py

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
