# Two commands: `make demo` runs the whole story, `make test` runs the tests.
# Each makes its own environment (.venv) from nothing but Python 3.11-3.13 and make.
PYTHON ?= python3
VENV ?= .venv
SEED ?= 1
BIN := $(VENV)/bin
# what no program here imports, and more than a third of all: not compiled ahead
NEVER := 'site-packages/(.+/tests|OpenGL|fontTools|mypyc?|pip)/'

.PHONY: demo test test-slow check docs pictures install clean

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --no-compile -e '.[test]'
	-$(BIN)/python -m compileall -q -j 2 -x $(NEVER) $(VENV) > /dev/null 2>&1
	touch $@

demo: install
	$(BIN)/hil demo -o out/demo --seed $(SEED)

# a file stays in one process, which makes what its tests share once; the longest files come first
test: export OMP_NUM_THREADS = 1
test: install
	$(BIN)/python -m pytest -n logical --maxprocesses 4 --dist loadfile --no-loadscope-reorder -m "not real_time and not slow"
	$(BIN)/python -m pytest -m "real_time and not slow" $$(grep -rlw real_time tests --include='test_*.py')

# whole pipelines of more than about three seconds each, further cases, and pages in a browser: before a release
test-slow: export OMP_NUM_THREADS = 1
test-slow: install
	$(BIN)/python -m pytest -n logical --maxprocesses 4 --dist loadfile -m "slow and not real_time"
	$(BIN)/python -m pytest -m "real_time and slow" $$(grep -rlw real_time tests --include='test_*.py')

check: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.docs
	$(BIN)/mkdocs build --strict

# the pictures of README and docs, from the real pages in Chromium
pictures: install
	$(BIN)/python docs/pictures.py

$(VENV)/.docs: pyproject.toml | install
	$(BIN)/python -m pip install --quiet -e '.[docs]'
	touch $@

clean:
	rm -rf $(VENV) out build *.egg-info
