# A virtual environment, the FMUs, the runs and the tests; needs Python >= 3.11 and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: run test test-all fuzz nightly lint reference bench clean

run: $(VENV)/.installed
	$(BIN)/orch run experiments/gripping_currents.toml

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n auto -m "not slow"

test-all: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n auto

fuzz: $(VENV)/.installed-dev
	ORCH_FUZZ=10 $(BIN)/python -m pytest -n auto tests/test_kills.py tests/test_fuzz.py tests/test_isolation.py

nightly: fuzz test-all # what takes longer than anybody waits for
	ORCH_FUZZ=10 $(BIN)/python -m pytest tests/test_every_command.py
	$(BIN)/python benchmarks/detector.py

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

reference: $(VENV)/.installed # after a change of the experiment file's keys
	$(BIN)/python -m orchestrator.experiment.schema.reference docs/experiment.md
	$(BIN)/python -m orchestrator.fmu.declared docs/fmus.md

bench: $(VENV)/.installed-bench
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/large.py
	$(BIN)/python benchmarks/store.py
	$(BIN)/python benchmarks/isolation.py
	$(BIN)/python benchmarks/sweep.py

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(VENV)/bin/python pyproject.toml setup.py orchestrator/simulation/_loop.c orchestrator/_watch.c
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[dev]"
	touch $@

$(VENV)/.installed-bench: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[bench,sweep]"
	touch $@

clean:
	rm -rf $(VENV) fmus/build .mypy_cache .pytest_cache .ruff_cache
