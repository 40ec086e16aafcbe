PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
CODE := tracker synthetic benchmarks examples scripts tests

.PHONY: demo test lint format bench gate colors clean
REAL ?= ../shared/real

demo: $(STAMP)  ## film the simulated platform, find the object in every frame
	$(BIN)/python examples/demo.py

test: $(STAMP)  ## run the tests
	$(BIN)/python -m pytest

lint: $(STAMP)  ## check style, types and floors
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(STAMP)  ## format the code
	$(BIN)/ruff check --fix $(CODE)
	$(BIN)/ruff format $(CODE)

bench: $(STAMP)  ## measure accuracy and speed: benchmarks/results.md, build/benchmarks/report.html
	$(BIN)/python -m benchmarks all --publish

gate: $(STAMP)  ## measure, and fail where a figure has fallen by more than its tolerance
	$(BIN)/python -m benchmarks all
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
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev,synthetic,film]'
	@touch $@
