# Everything from a fresh clone: `make paper` and `make test` need Python 3.11 or newer and nothing else.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.DEFAULT_GOAL := help
.PHONY: help paper test findings quick long lint docs pictures lock install clean

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):.*##/\1	/p' $(MAKEFILE_LIST)

paper: $(STAMP)  ## reproduce the paper; the report is results/paper/report.html
	$(BIN)/omnirange run paper

test: $(STAMP)  ## run the tests, on all cores
	$(BIN)/python -m pytest -n auto --dist loadfile -m "not long"

findings: $(STAMP)  ## measure anew what the README quotes, into results/reference/, and say what changed: hours; goes on after Ctrl-C
	$(BIN)/python results/reference/regenerate.py
	$(BIN)/python results/reference/findings.py

quick: $(STAMP)  ## run the tests that are not slow; one that has become slow fails
	$(BIN)/python -m pytest -n auto --dist loadfile -q -m "not slow and not long" --most-cpu-s 5

long: $(STAMP)  ## run the tests that are left out of `make test`: long repetitions of what it tests
	$(BIN)/python -m pytest -n auto --dist worksteal -m long

lint: $(STAMP)  ## style, formatting, types and the one-way imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(STAMP)  ## build the documentation; the site is docs/_build/html/index.html
	$(BIN)/sphinx-build --builder html --fail-on-warning --keep-going --jobs auto --quiet docs docs/_build/html

pictures: $(STAMP)  ## draw the pictures of the README and of the documentation anew; needs Chromium
	$(BIN)/python docs/make_pictures.py
	$(BIN)/python docs/make_concepts.py

lock: $(STAMP)  ## lock the dependencies anew; LOCK_FLAGS=--upgrade takes the newest
	$(BIN)/uv pip compile pyproject.toml --extra dev --output-file requirements.lock \
		--universal --python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-emit-find-links --custom-compile-command "make lock" --quiet $(LOCK_FLAGS)

install: $(STAMP)  ## make the environment in .venv, from the lock alone

# The stamp is newer than what it was made from, so that a second call installs nothing.
$(STAMP): requirements.lock pyproject.toml
	@command -v $(PYTHON) > /dev/null || { echo "omnirange: no $(PYTHON) here; name one with PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "omnirange: needs Python 3.11 or newer, $(PYTHON) is older; name another with PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

clean:  ## remove the environment, builds and caches; results stay
	rm -rf $(VENV) build dist docs/_build docs/generated .hypothesis .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
