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

MUTATION := .venv-mutation
PROOF_TESTS := tests/onboard/test_mission.py tests/onboard/test_safety_*.py tests/drivers/test_bracket*.py \
	tests/drivers/test_can_p*.py
PROVEN := onboard/safety*.py,onboard/mission.py,drivers/bracket*.py,drivers/can_p*.py,drivers/cia402_port.py

# a virtual environment of its own, on top of the first: mutmut and the LiDAR's library want different versions of click
$(MUTATION)/.installed: $(STAMP)
	$(PYTHON) -m venv $(MUTATION)
	$(MUTATION)/bin/pip install --quiet 'mutmut>=3.8,<4'
	$(VENV)/bin/python -c 'import site; print(site.getsitepackages()[0])' > \
		$$($(MUTATION)/bin/python -c 'import site; print(site.getsitepackages()[0])')/tests.pth
	touch $@

.PHONY: setup demo test lint proof results clean
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

proof: setup $(MUTATION)/.installed  ## branch coverage and mutants of what releases and flies (docs/safety.md)
	$(VENV)/bin/python -m coverage run --branch --include='$(PROVEN)' -m pytest $(PROOF_TESTS)
	$(VENV)/bin/python -m coverage report --show-missing --fail-under=100
	PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 $(MUTATION)/bin/python -m mutmut run --max-children 2
	$(MUTATION)/bin/python -m mutmut results

results: setup  ## every mission of docs/results.md again (about an hour on two cores)
	$(VENV)/bin/python -m benchmarks.missions --out runs --table docs/results.md

clean:
	rm -rf $(VENV) $(MUTATION) mutants run runs
