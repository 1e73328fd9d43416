# `make measure` and `make test` do all set-up themselves: Python 3.11+ and make are enough.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# Where it is set every command compiles our modules anew, which takes 1.4 s, and pytest all its tests.
export PYTHONDONTWRITEBYTECODE :=
# Matrices are small here: a second thread costs more than it saves, ten times as much where processes share the cores.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
RUNS   := $(VENV)/.runs
READY  := $(VENV)/.ready
LOWEST := .venv-lowest
SEED   ?= $(shell date +%s)
ORDER  ?= $(SEED)
# What pip compiles in one process two do in half the time; nobody runs the packages' own tests.
PIP    := -m pip install --quiet --disable-pip-version-check --no-compile
COMPILE := -m compileall -qq -j 0 -x '/tests?/'
define NEW_VENV
$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(0 if v >= (3, 11) else "Python 3.11 or newer is needed, this is %d.%d: try make PYTHON=python3.12" % v[:2])'
$(PYTHON) -m venv $(VENV)
endef

.PHONY: measure sample test test-slow test-lowest explore golden lint docs site clean

measure: $(RUNS)
	$(BIN)/gyrolock measure

# Runs, a memory card and logs that the command lines of the guides read: sample/ring_laser and sample/fibre_gyro.
sample: $(READY)
	$(BIN)/python docs/sample.py

# Four at once on two cores: many wait for an instrument. Who is done takes over what others still have before them.
# In another order each time; `make test ORDER=...` goes through them in the same again.
test: $(READY)
	$(BIN)/python -m pytest -n 4 --dist worksteal --randomly-seed $(ORDER)

# All tests with the lowest versions that pyproject.toml states.
test-lowest: $(LOWEST)/.ready
	$(LOWEST)/bin/python -m pytest -n 2

# What takes long and has a shorter sibling above.
test-slow: $(READY)
	$(BIN)/python -m pytest -n 4 --dist worksteal --randomly-seed $(ORDER) -m slow --timeout 1800

# Property tests alone, each searching freely from a new seed; `make explore SEED=...` goes the same way again.
explore: $(READY)
	$(BIN)/python -m pytest -n 2 -m hypothesis --timeout 1800 --hypothesis-profile explore --hypothesis-seed $(SEED)

# What the golden runs give, written again: only where a change of it is wanted, and said in CHANGELOG.md.
golden: $(READY)
	$(BIN)/python tests/golden_outputs/outputs.py --store

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# docs/commands.md, docs/api.md and docs/results.md, from commands, docstrings and declarations themselves.
docs: $(READY)
	$(BIN)/python docs/commands.py
	$(BIN)/python docs/api.py
	$(BIN)/python docs/results.py

# The guides as a site in build/site; a link that leads nowhere ends it.
site: $(READY)
	$(BIN)/python $(PIP) --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

# What `gyrolock` runs with. The tests and their tools are more; who has them has this too.
$(RUNS): pyproject.toml
	$(NEW_VENV)
	$(BIN)/python $(PIP) --editable .
	-$(BIN)/python $(COMPILE) $(VENV)
	touch $(RUNS)

$(READY): pyproject.toml
	$(NEW_VENV)
	$(BIN)/python $(PIP) --editable '.[dev]'
	-$(BIN)/python $(COMPILE) $(VENV)
	touch $(RUNS) $(READY)

$(LOWEST)/.ready: pyproject.toml
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python tests/house/lowest_versions.py > $(LOWEST)/requirements.txt
	$(LOWEST)/bin/python $(PIP) --requirement $(LOWEST)/requirements.txt editables
	$(LOWEST)/bin/python $(PIP) --no-build-isolation --editable '.[test]'
	touch $(LOWEST)/.ready

clean:
	rm -rf $(VENV) $(LOWEST) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
