# Builds, checks and runs the project from a bare checkout: Python 3.12 or newer, git and make are
# all that must be there. Everything is installed into .venv, in stages, each with its stamp:
#
#   .venv/.stamp-made      the empty environment; holds the folder it was made in
#   .venv/.stamp-runtime   the package (editable) and what it needs to run
#   .venv/.stamp-test      the extra "test"
#   .venv/.stamp-bench     the extra "bench"
#
# A stamp is written when its stage is complete, and a stage older than pyproject.toml or
# constraints.txt is done again. The whole environment is rebuilt when its first stamp is missing,
# when an installation was interrupted (.venv/.unfinished stands), when the folder was moved and
# when its interpreter no longer starts.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
# Two pips must not write to one environment at once.
.NOTPARALLEL:
.PHONY: help demo test bench clean FORCE

VENV := .venv
VENV_PYTHON := $(VENV)/bin/python
PIP_INSTALL := $(VENV_PYTHON) -m pip install --quiet --disable-pip-version-check \
    --constraint constraints.txt
PINS := pyproject.toml constraints.txt
# Test processes beside the first: a number, or "auto" for one per core.
WORKERS ?= auto

help:
	@echo "make demo    run the demonstration, procmodel demo"
	@echo "make test    lint, format check, types and tests; WORKERS=0 runs the tests in one process"
	@echo "make bench   run the benchmarks beside their peers"
	@echo "make clean   remove .venv, caches, build products and the demonstration's output"
	@echo "Each installs what it needs into .venv first; PYTHON=/path/to/python chooses the interpreter."

demo: $(VENV)/.stamp-runtime
	@$(VENV)/bin/procmodel demo

test: $(VENV)/.stamp-test
	@echo "ruff check"
	@$(VENV_PYTHON) -m ruff check --quiet .
	@echo "ruff format --check"
	@$(VENV_PYTHON) -m ruff format --check .
	@echo "mypy"
	@$(VENV_PYTHON) -m mypy
	@echo "pytest"
	@$(VENV_PYTHON) -m pytest -n $(WORKERS)

bench: $(VENV)/.stamp-bench
	@$(VENV_PYTHON) -m benchmarks

clean:
	rm -rf $(VENV) build dist demo-output *.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find . -path ./.git -prune -o -type d -name __pycache__ -prune -exec rm -rf {} +

# "sound" when the environment was made in this folder, is complete and starts; if it is not, its
# stamp depends on FORCE, which is always out of date.
venv_state := $(shell test "$$(cat $(VENV)/.stamp-made 2>/dev/null)" = "$$(pwd -P)" \
    && test ! -e $(VENV)/.unfinished && $(VENV_PYTHON) -c 'print("sound")' 2>/dev/null)

$(VENV)/.stamp-made: $(if $(filter sound,$(venv_state)),,FORCE)
	@python=$$(sh .ci/find-python) || exit 2; \
	echo "making $(VENV) with $$("$$python" --version) ..."; \
	rm -rf $(VENV) && "$$python" -m venv $(VENV)
	@pwd -P > $@

# The build backend goes in first, pinned like the rest, and builds without isolation: an isolated
# build would fetch its own, and pip's versions differ in whether constraints reach it.
$(VENV)/.stamp-runtime: $(VENV)/.stamp-made $(PINS)
	@echo "installing procmodel into $(VENV) ..."
	@touch $(VENV)/.unfinished
	@$(PIP_INSTALL) hatchling
	@$(PIP_INSTALL) --no-build-isolation --editable .
	@touch $@ && rm $(VENV)/.unfinished

$(VENV)/.stamp-test: $(VENV)/.stamp-runtime
	@echo "installing what the checks need into $(VENV) ..."
	@touch $(VENV)/.unfinished
	@$(PIP_INSTALL) --no-build-isolation --editable '.[test]'
	@touch $@ && rm $(VENV)/.unfinished

$(VENV)/.stamp-bench: $(VENV)/.stamp-runtime
	@echo "installing what the benchmarks need into $(VENV) ..."
	@touch $(VENV)/.unfinished
	@$(PIP_INSTALL) --no-build-isolation --editable '.[bench]'
	@touch $@ && rm $(VENV)/.unfinished
