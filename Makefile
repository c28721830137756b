# Needs Python >= 3.11 and make, nothing else.  `make PYTHON=python3.12` picks the interpreter of a new environment,
# `make VENV=path` uses (or makes) an environment elsewhere.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.pixelid-installed
# pip byte-compiles one module after another; `setup` does, in as many processes as there are processors.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt
# Where pip finds a CPU build of torch, when the default index has only the CUDA one (Linux without an NVIDIA GPU):
# `make TORCH_INDEX=https://download.pytorch.org/whl/cpu`.
TORCH_INDEX ?=
# Test processes.
WORKERS ?= 2
# Damaged files of `make fuzz`: some 300 a second.
RUNS ?= 20000
SEED ?= 0

.PHONY: help setup demo test test-all bench ablations fuzz models lint docs clean
.DEFAULT_GOAL := help

help:
	@echo "make demo       calibrate a bench session that comes with pixelid, and say what was hidden and found: demo-out/"
	@echo "make test       every test that is not slow"
	@echo "make test-all   every test"
	@echo "make ablations  train scenes under other pixels, samples, batches, speeds and lights, into docs/reconstruction.json (hours)"
	@echo "make bench      measure the speed of every path again, into docs/speed.json (without --again a run is continued)"
	@echo "make fuzz       damaged files for every reader, RUNS of them from SEED; failures are kept in fuzz-failures/"
	@echo "make models     fit the shipped models of real sensors again, from the tables in fits/"
	@echo "make lint       ruff and pyright"
	@echo "make docs       the documentation site, in docs/_build/html; any warning is an error"
	@echo "make clean      remove what make and the tests have made, the environment included"

setup: $(STAMP)

# What simulate, fit and reconstruct need is compiled now; where that fails, it is compiled when it is used.
# torch first and pinned: a bare `torch` may pull gigabytes of CUDA where the pinned one has a CPU build.
$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) $$(grep '^torch==' constraints.txt)
	$(PIP) -e ".[dev]"
	@$(BIN)/python -m compileall -q -j 0 $(VENV)/lib >/dev/null 2>&1 || true  # some are of a later Python
	-$(BIN)/python -m pixelid.compilation
	touch $@

demo: $(STAMP)
	$(BIN)/pixelid demo --out demo-out --overwrite

# Every process has its share in order, so that tests of one file share their fixtures, and takes of others' in the end.
TESTS := $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

test: $(STAMP)
	$(TESTS) -m "not slow"

test-all: $(STAMP)
	$(TESTS)

ablations: $(STAMP)
	$(BIN)/python benchmarks/reconstruction.py bandwidth baselines samples batch joint grid --settings hard8 --save docs/reconstruction.json

bench: $(STAMP)
	$(BIN)/python benchmarks/speed.py --out docs/speed.json --again

fuzz: $(STAMP)
	$(BIN)/python tests/fuzz.py --runs $(RUNS) --seed $(SEED)

models: $(STAMP)
	mkdir -p out
	set -e; for sensor in gen31 imx636; do \
	  $(BIN)/pixelid latency fits/$$sensor.toml --out out/$$sensor --overwrite; \
	  cp out/$$sensor/model.toml models/$$sensor.toml; done
	$(BIN)/python benchmarks/latency_poles.py

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(STAMP)
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

clean:
	rm -rf .venv docs/_build docs/_generated build dist demo-out out fuzz-failures .pytest_cache .ruff_cache .numba_cache .hypothesis *.egg-info
	find pixelid tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +
