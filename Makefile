# Two commands do everything on a fresh machine that has Python 3.11 or later with venv, and make:
#   make demo    sets up and runs the main job
#   make test    sets up and passes the tests
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3 python; do \
	"$$p" -c 'import sys, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$$p" && break; done)
VENV ?= .venv
BIN := $(VENV)/bin
WORKERS ?= 2

.PHONY: demo test slow lint types docs bench clean

demo: $(VENV)/core.stamp
	$(BIN)/boresight demo

test: $(VENV)/dev.stamp
	$(BIN)/python -m pytest -n $(WORKERS) -m "not slow"

slow: $(VENV)/dev.stamp
	$(BIN)/python -m pytest -n $(WORKERS) -m slow

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/dev.stamp
	$(BIN)/mypy

docs: $(VENV)/dev.stamp
	$(BIN)/zensical build --clean --strict

bench: $(VENV)/dev.stamp
	for script in benchmarks/*.py; do $(BIN)/python $$script --quick || exit 1; done

$(VENV)/python.stamp:
	@test -n "$(PYTHON)" || { echo "Boresight needs Python 3.11 or later with venv; name one: make PYTHON=/path/to/python" >&2; exit 1; }
	"$(PYTHON)" -m venv $(VENV)
	@touch $@

$(VENV)/core.stamp: $(VENV)/python.stamp pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(VENV)/dev.stamp: $(VENV)/python.stamp pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@ $(VENV)/core.stamp

clean:
	rm -rf $(VENV) site boresight-demo .mypy_cache .ruff_cache .pytest_cache
