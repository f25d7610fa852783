# The two commands that a new user needs: `make demo` and `make test`. Both set everything up first.
PYTHON ?= python3
VENV := .venv
STAMP := $(VENV)/.installed

$(STAMP): pyproject.toml
	.ci/system-packages $(PYTHON)
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install --quiet --upgrade pip
	$(VENV)/bin/pip install --quiet --editable ".[dev]"
	touch $@

.PHONY: setup demo test lint results clean
setup: $(STAMP)

demo: setup  ## the whole mission in a simulated building: explore, deploy, regroup, merge
	$(VENV)/bin/marsupial simulate --world building --seed 1 --duration 900 --out run --force

lint: setup
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports
	$(VENV)/bin/python tests/check_sizes.py

test: lint
	$(VENV)/bin/python -m pytest

results: setup  ## every mission of docs/results.md again (about an hour on two cores)
	$(VENV)/bin/python -m benchmarks.missions --out runs --table docs/results.md

clean:
	rm -rf $(VENV) run runs
