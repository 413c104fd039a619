# Every target works from a fresh clone: it makes .venv first, and again whenever a dependency changes.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test lint bench clean

demo: .venv/core
	$(BIN)/pendulum-ident demo

test: lint
	$(BIN)/pytest

lint: .venv/dev
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy

bench: .venv/dev
	$(BIN)/python -m benchmarks

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
