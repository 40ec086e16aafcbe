PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
CODE := tracker synthetic benchmarks examples scripts tests
REAL ?= ../shared/real
SCENES ?= 200
WORKERS ?= $(shell nproc 2>/dev/null || echo 1)
LOWEST := build/lowest
OLDEST_PYTHON ?= python3.10

.PHONY: demo test lowest release package lint format docs bench gate colors clean

demo: $(STAMP)  ## film the simulated platform, find the object in every frame
	$(BIN)/python examples/demo.py

# Kernels are compiled before, once for all processes.
RUN_TESTS = -c 'from tracker.warm_up import warm_up; warm_up()' && $(1)/python -m pytest \
	--numprocesses $(WORKERS) --dist worksteal --durations=15 -rs

test: $(STAMP)  ## run the tests, or those of TESTS=
	$(BIN)/python $(call RUN_TESTS,$(BIN)) $(TESTS)

# Old versions use what newer ones of others warn of.
lowest: $(LOWEST)/.installed  ## run the tests with the lowest versions that pyproject.toml allows
	$(LOWEST)/bin/python $(call RUN_TESTS,$(LOWEST)/bin) -W ignore::DeprecationWarning $(TESTS)

release: $(STAMP)  ## build sdist and wheel, try the wheel alone with each Python of PYTHONS=
	$(BIN)/python scripts/try_release.py $(PYTHONS)

package: $(STAMP)  ## set up the platform's own simulation package, with which some tests compare
	$(BIN)/python -c 'from benchmarks.data.package.environment import interpreter; print(interpreter())'

lint: $(STAMP)  ## check style, types and floors
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(STAMP)  ## format the code
	$(BIN)/ruff check --fix $(CODE)
	$(BIN)/ruff format $(CODE)

docs: $(STAMP)  ## build the documentation's site: build/site/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

bench: $(STAMP)  ## measure everything on unseen scenes, and publish: benchmarks/results.md, the figures of the pages
	$(BIN)/python -m benchmarks all --publish --scenes $(SCENES)

gate: $(STAMP)  ## few scenes, each compared with itself as it was: fail where something is worse
	$(BIN)/python -m benchmarks gate

colors: $(STAMP)  ## fit the shipped colour tables again, from the labelled images in $(REAL)
	$(BIN)/python scripts/fit_shipped_colors.py $(REAL)

clean:  ## remove everything that the other targets made
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis build dist
	find . -name __pycache__ -type d -not -path './.git/*' -prune -exec rm -rf {} +

# The stamp is made last, so that an installation that was broken off is done again.
$(STAMP): pyproject.toml
	@echo "Setting up $(VENV) (about a minute and a half)"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev,docs,synthetic]'
	@touch $@

# zarr: the last that writes the stores of the platform's data sets.
$(LOWEST)/.installed: pyproject.toml scripts/lowest_versions.py
	$(OLDEST_PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check packaging tomli
	$(LOWEST)/bin/python scripts/lowest_versions.py synthetic video datasets bench cluster > $(LOWEST)/requirements.txt
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check \
		-r $(LOWEST)/requirements.txt 'zarr<2.17'
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	@touch $@
