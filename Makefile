# The project's task runner. Every target works from an empty environment with Python 3.11 or later.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV   ?= .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready

.PHONY: audit mutants help setup demo test test-slow test-integration lint types bench docs dashboards lock clean

help:            ## Show the targets
	@grep -hE '^[a-z-]+: .*## ' $(MAKEFILE_LIST) | awk -F':.*## ' '{printf "  make %-18s %s\n", $$1, $$2}'

$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or later is needed; set PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

setup: $(READY)  ## Make the virtual environment from the hash-locked requirements

demo: $(READY)   ## Simulate a plant, stream it through the daemon, raise the alarm, write the report
	$(BIN)/fdd demo

test: $(READY)   ## Run the default test suite
	$(BIN)/python -m pytest -n 2 --dist loadfile

test-slow: $(READY)  ## Run the slow statistical tests as well
	$(BIN)/python -m pytest -m "slow and not integration" -n 2 --dist loadfile --timeout 1800

test-integration: $(READY)  ## Run the tests against real servers
	$(BIN)/python -m pytest -m integration --timeout 1800

lint: $(READY)   ## Style, types, and the direction of dependencies
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

mutants: $(READY)  ## Which tests fail if a core line is changed: a sample of mutants
	$(BIN)/python -m benchmarks.mutants

audit: $(READY)  ## Known vulnerabilities, SBOM (CycloneDX) and licences of what is locked, into var/audit
	deploy/audit.sh $(BIN)/python

bench: $(READY)  ## Every benchmark, quick size
	@for b in kernels components chiller_eiv alarms service doors; do $(BIN)/python -m benchmarks.$$b --quick || exit 1; done

lock:            ## Refresh requirements.lock (needs uv)
	uv pip compile pyproject.toml --extra dev --extra cluster --extra mqtt --extra bacnet --generate-hashes --no-header --universal --python-version 3.11 -o requirements.lock

clean:           ## Remove the virtual environment and what the demo wrote
	rm -rf $(VENV) var
