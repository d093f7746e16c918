# `make run` and `make test` need nothing but make and Python 3.11, 3.12 or 3.13.
# Another Python, in an environment of its own: make run PYTHON=python3.13 VENV=.venv-3.13
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
TESTS ?=
# An environment is of one Python; this is "none" where PYTHON does not run.
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' \
	2>/dev/null || echo none)
RUNS := $(VENV)/.runs-$(VERSION)
TESTED := $(VENV)/.tests-$(VERSION)
DOCUMENTED := $(VENV)/.docs-$(VERSION)
# What is left of another Python's, or of an installation that failed, goes.
CLEAR = $(if $(wildcard $@),,$(if $(wildcard $(VENV)/pyvenv.cfg),--clear))
# Compiling 4,000 modules would take as long as downloading them; what is imported gets
# compiled then, and kept, which this variable would forbid.
unexport PYTHONDONTWRITEBYTECODE
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile

.PHONY: run test test-long test-lowest docs lint clean python

run: $(RUNS)  ## the built-in dance, recorded: out/dance/
	$(BIN)/crar-drake run

test: $(TESTED)  ## all tests; CRAR_MOCAP_PATH names the folder of real CMU files
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder $(TESTS)

test-long: $(TESTED)  ## what `make test` does in a shorter form only
	$(BIN)/python -m pytest -n auto --dist loadfile -m long $(TESTS)

# In an environment of its own. Python 3.11 is the lowest, too, and later ones lack some
# of these versions. MuJoCo 3 rounds inertias to 1e-8 kg m², which the test that is left
# out does not allow.
LOWEST_PYTHON ?= python3.11
LOWEST := $(VENV)-lowest
LOWEST_TESTS ?= tests/models tests/robot tests/motion/test_builtin_motions.py \
	tests/motion/test_retarget.py tests/motion/test_conditioning.py tests/targets \
	tests/results/test_log.py tests/results/test_plots.py tests/judging/test_referee.py \
	tests/results/test_summary.py tests/judging/test_mesh_judge.py tests/simulation \
	tests/robot_import/test_mesh_formats.py tests/robot_import/test_source_mjcf.py \
	tests/motion/formats/test_c3d.py tests/test_yaml_files.py

test-lowest: $(LOWEST)/.ready  ## a fast part of the tests with the lowest versions
	$(LOWEST)/bin/python -m pytest -n auto --dist loadfile -m "not slow and not long" \
	  --deselect tests/robot_import/test_source_mjcf.py::test_it_weighs_what_drake_says \
	  $(LOWEST_TESTS)

$(LOWEST)/.ready: pyproject.toml tests/lowest.txt
	$(LOWEST_PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check --no-compile \
	  -r tests/lowest.txt -e . "pytest>=8" "pytest-xdist>=3" "hypothesis>=6"
	touch $@

# Warnings are errors. Once installed it needs no network.
docs: $(DOCUMENTED)  ## the documentation as a site: out/site/docs/site/index.html
	$(BIN)/python -m sphinx -q -W --keep-going -j auto -c docs/site -d out/doctrees . out/site
	@echo out/site/docs/site/index.html

lint: $(TESTED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# What a run needs is a third of what the tests need.
$(RUNS): pyproject.toml | python
	rm -f $(VENV)/.runs-* $(VENV)/.tests-* $(VENV)/.docs-*
	$(PYTHON) -m venv $(CLEAR) $(VENV)
	$(INSTALL) -e .
	touch $@

$(TESTED): $(RUNS)
	$(INSTALL) -e ".[dev]"
	touch $@

$(DOCUMENTED): $(RUNS)
	$(INSTALL) -e ".[docs]"
	touch $@

python:
	@$(PYTHON) -c "" 2>/dev/null || { \
	  echo "$(PYTHON) does not run here: install Python 3.11, 3.12 or 3.13, or" \
	    "name one, as in make run PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11))" || { \
	  echo "crar_drake needs Python 3.11, 3.12 or 3.13, and $(PYTHON) is" \
	    "$(VERSION): name another, as in make run PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c "import ensurepip, venv" 2>/dev/null || { \
	  echo "$(PYTHON) cannot make environments: install its module venv (on Debian" \
	    "and Ubuntu, apt install python3-venv)" >&2; exit 1; }

clean:
	rm -rf .venv .venv-* $(VENV) out build dist *.egg-info
