PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
CODE := tracker synthetic benchmarks examples scripts tests
PROSE := README.md CHANGELOG.md CONTRIBUTING.md docs $(CODE)
REAL ?= ../shared/real
SCENES ?= 200
# One more than there are processors: tests wait a quarter of their time, for processes and sleeping sources.
WORKERS ?= $(shell echo $$(($$(nproc 2>/dev/null || echo 1) + 1)))
LOWEST := build/lowest
OLDEST_PYTHON ?= python3.10

# What takes long to make stays outside of the checkout, for the next clone: environments, machine code,
# scenes. Each is named after all that decides what is in it.
CACHE := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/trifinger-object-tracker
export NUMBA_CACHE_DIR ?= $(CACHE)/kernels
# Every process would compile all sources again.
export PYTHONDONTWRITEBYTECODE :=
PIP_INSTALL := -m pip install --quiet --disable-pip-version-check --no-deps
KEPT := scripts/kept_environment.py

.PHONY: demo test lowest release package lint format docs bench gate colors clean

demo: $(STAMP)  ## film the simulated platform, find the object in every frame
	@rm -rf build/demo
	$(BIN)/python examples/demo.py --output build/demo

# Kernels are compiled before, once for all processes.
RUN_TESTS = -c 'from tracker.warm_up import warm_up; warm_up()' && $(1)/python -m pytest \
	--numprocesses $(WORKERS) --dist worksteal --durations=15 -rs

test: $(STAMP) | build/scenes  ## run the tests, or those of TESTS=
	$(BIN)/python $(call RUN_TESTS,$(BIN)) $(TESTS)

# What calls other libraries, and a pose from pictures to end: what else `make test` shows does not depend on
# versions. Old versions use what newer ones of others warn of.
LOWEST_TESTS := $(addprefix tests/,files geometry logs poses viz calibration/board/test_board.py \
	color_learning/test_hues.py batch/test_jobs.py batch/test_run.py batch/test_stores.py \
	synthetic/test_renderers.py benchmarks/test_metrics.py test_compiled.py test_import.py test_pipeline.py)

lowest: $(LOWEST)/.installed | build/scenes  ## run tests with the lowest versions that pyproject.toml allows
	$(LOWEST)/bin/python $(call RUN_TESTS,$(LOWEST)/bin) -W ignore::DeprecationWarning \
		$(or $(TESTS),$(LOWEST_TESTS))

release: $(STAMP)  ## build sdist and wheel, try the wheel alone with each Python of PYTHONS=
	$(BIN)/python scripts/try_release.py $(PYTHONS)

package: $(STAMP) | build/scenes  ## set up the platform's own simulation package, with which some tests compare
	$(BIN)/python -c 'from benchmarks.data.package.environment import interpreter; print(interpreter())'

lint: $(STAMP)  ## check style, words, types and layers
	$(BIN)/codespell --dictionary=- --dictionary=docs/style/words.txt $(PROSE)
	$(BIN)/python scripts/check_phrases.py $(PROSE)
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)
	$(BIN)/mypy
	$(BIN)/mypy examples/*.py
	$(BIN)/lint-imports

format: $(STAMP)  ## format the code
	$(BIN)/ruff check --fix $(CODE)
	$(BIN)/ruff format $(CODE)

docs: $(STAMP)  ## build the documentation's site: build/site/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

bench: $(STAMP) | build/scenes  ## measure everything on unseen scenes, and publish: benchmarks/results.md, the figures of the pages
	$(BIN)/python -m benchmarks all --publish --scenes $(SCENES)

gate: $(STAMP) | build/scenes  ## few scenes, each compared with itself as it was: fail where something is worse
	$(BIN)/python -m benchmarks gate

colors: $(STAMP)  ## fit the shipped colour tables again, from the labelled images in $(REAL)
	$(BIN)/python scripts/fit_shipped_colors.py $(REAL)

clean:  ## remove everything that the other targets made
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis build dist
	find . -name __pycache__ -type d -not -path './.git/*' -prune -exec rm -rf {} +

build/scenes:
	@mkdir -p build $(CACHE)/scenes
	@ln -s $(CACHE)/scenes $@

# The stamp is made last, so that an interrupted installation is done again.
$(STAMP): pyproject.toml $(KEPT)
	@echo "Setting up $(VENV) (two minutes, or seconds where another clone did it before)"
	$(PYTHON) $(KEPT) $(VENV) hatchling hatch-vcs '.[dev,docs,synthetic]'
	$(BIN)/python $(PIP_INSTALL) --no-build-isolation -e .
	@touch $@

# zarr: the last that writes the stores of the platform's data sets.
$(LOWEST)/.installed: pyproject.toml scripts/lowest_versions.py $(KEPT) | $(STAMP)
	@mkdir -p build
	$(BIN)/python scripts/lowest_versions.py --python 3.10 synthetic video datasets bench cluster > $(LOWEST).txt
	$(OLDEST_PYTHON) $(KEPT) $(LOWEST) -r $(LOWEST).txt 'zarr<2.17'
	$(LOWEST)/bin/python $(PIP_INSTALL) -e .
	@touch $@
