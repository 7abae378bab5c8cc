# `make help` lists the targets; each starts from a bare Python 3.11 and installs what it needs into $(VENV).
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV ?= .venv
# TORCH_CPU=1: PyTorch without CUDA, whose libraries take gigabytes on Linux and need an NVIDIA GPU
TORCH_CPU ?=
BIN := $(VENV)/bin
EXAMPLE := examples/example_tracker
TEMPLATES := $(EXAMPLE):$(EXAMPLE)/tests:examples/learned_tracker:examples/learned_tracker/tests
HALL := data/leg_tracker/leg_tracker.mcap
# the first twenty seconds after the warm-up of each place that no tracker has seen
WORLDS := $(addsuffix @0s-24.5s,$(wildcard data/worlds/test/*.tracks))
JUNCTION := $(wildcard data/junction/test-*.tracks) --validation data/junction/validation.tracks
DEMO_TRACKERS := kalman factor-graph dilated-convgru
# floors are compared without being named
HALL_TRACKERS := kalman factor-graph dogma deep-tracking-rnn dilated-convgru
JUNCTION_TRACKERS := kalman factor-graph dogma dilated-convgru one-shot
COMPARE := $(BIN)/gridtrack compare
INSTALL := $(BIN)/pip install --constraint constraints.txt $(if $(TORCH_CPU),--extra-index-url https://download.pytorch.org/whl/cpu )--editable
# with bytecode, whatever the environment says, because hundreds of processes import the package
PYTEST := PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest
# a worker more makes its fixtures and imports once more, which costs as much as it gains
WORKERS := -n $(shell nproc) --dist worksteal --durations=10
ENGINES := tests/evaluation/engines
chosen = $(foreach tracker,$(1),--tracker $(tracker))
# with general weights: they have seen no recording of a site
new = $(foreach tracker,$(1),--tracker new-$(tracker)=$(tracker):card=general)
# studies/trainings/seed-2/dilated-convgru/junction.toml: another training, as the row "dilated-convgru 2"
folders = $(subst /, ,$(1))
training = --tracker '$(word 4,$(folders)) $(patsubst seed-%,%,$(word 3,$(folders)))=$(word 4,$(folders)):weights=studies/trainings/$(word 3,$(folders))'
trainings = $(foreach card,$(wildcard studies/trainings/seed-*/*/junction.toml),$(call training,$(card)))

.PHONY: help demo demo-junction test lint-beside compiled pytest pytest-engines check coverage lint bench results worlds-results real-results schemas lock docs figures size screenshots ablations returns junction weights baseline clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):[^#]*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 15

demo: $(VENV)/.installed-demo ## compare trackers on twenty places that none has seen, and in a real hall (some minutes)
	rm -rf runs/demo runs/demo-hall
	$(COMPARE) $(HALL)@100s-124s $(call chosen,$(DEMO_TRACKERS)) --every 0.5s --latency --out runs/demo-hall
	$(COMPARE) $(WORLDS) $(call chosen,$(DEMO_TRACKERS)) --warm-up 2s --every 0.5s --out runs/demo

demo-junction: $(VENV)/.installed-demo ## compare five trackers and the floors on twenty minutes at a simulated junction
	rm -rf runs/junction
	$(COMPARE) $(JUNCTION) $(call chosen,$(JUNCTION_TRACKERS)) --out runs/junction

test: $(VENV)/.installed-dev ## run lint, types and all tests
	$(MAKE) --jobs 3 lint-beside pytest pytest-engines

# lint takes what the tests leave of the processors
lint-beside:
	nice -n 19 $(MAKE) lint

# else each of the workers of pytest compiles all kernels for itself in its first minute
compiled: $(VENV)/.installed-dev
	rm -rf runs/compiled
	$(COMPARE) $(HALL)@114s-119s $(call chosen,kalman factor-graph dogma) --no-floors --horizon 1s --jobs 1 --out runs/compiled

pytest: $(VENV)/.installed-dev compiled
	$(PYTEST) $(WORKERS) --ignore=$(ENGINES)

# tests of engines wait for nodes and timeouts three quarters of their time: they take no worker of the others
pytest-engines: $(VENV)/.installed-dev compiled
	$(PYTEST) -q $(ENGINES)

check: $(VENV)/.installed-dev | .link/gridtrack ## lint and test what changed since the last commit, for a minute (SINCE=main: since that revision)
	PYTHONPATH=tests $(BIN)/python -m affected --since $(or $(SINCE),HEAD)

coverage: $(VENV)/.installed-dev ## run all tests; print the coverage and the ten files with the least
	$(PYTEST) $(WORKERS) --cov --cov-report=
	$(BIN)/coverage report | sed -n '1,12p;$$p'

lint: $(VENV)/.installed-dev | .link/gridtrack ## check style, spelling, types and the import rule
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell
	MYPYPATH=.link $(BIN)/mypy -p gridtrack
	MYPYPATH=.link:.:$(TEMPLATES) $(BIN)/mypy -p benchmarks -p studies $(foreach name,example_tracker learned_tracker,-m $(name) -m test_$(name))
	PYTHONPATH=.link $(BIN)/lint-imports

fuzz: $(VENV)/.installed-dev ## fuzz every reader of untrusted input for ten minutes (FUZZ="--minutes 60 --only tracks")
	PYTHONPATH=tests $(BIN)/python -m fuzz $(FUZZ)

bench: $(VENV)/.installed-dev ## measure the speed of everything that `make test` installs (half an hour)
	$(BIN)/python -m benchmarks

results: $(VENV)/.installed-dev ## compare every tracker at the junction and in the hall: the numbers of docs/results/junction and leg_tracker
	rm -rf runs/results runs/hall
	$(COMPARE) $(HALL) $(call chosen,$(HALL_TRACKERS)) $(call new,$(HALL_TRACKERS)) --every 0.5s --latency --out runs/hall
	$(BIN)/python -m studies.kept_summary runs/hall leg_tracker
	$(COMPARE) $(JUNCTION) $(call chosen,$(JUNCTION_TRACKERS) deep-tracking-rnn conv-lstm simvp pool static-map:card=general site-map=static-map) $(trainings) --reference dilated-convgru --out runs/results
	$(BIN)/python -m studies.kept_summary runs/results junction
	$(BIN)/python -m studies.static_memory

worlds-results: $(VENV)/.installed-dev ## compare every tracker with general weights on the test worlds: the numbers of docs/results/worlds
	$(BIN)/python -m studies.worlds_results

real-results: $(VENV)/.installed-dev ## the same on recordings of real robots, in the folder DATA: docs/results/real
	$(BIN)/python -m studies.real_results $(DATA)

schemas: $(VENV)/.installed-dev ## write the JSON Schemas of the result files into docs/schemas
	$(BIN)/python -m gridtrack.evaluation.schemas docs/schemas

# the oldest Python on which the versions of constraints.txt can all be installed
lock: $(VENV)/.installed-dev ## write constraints.lock: the versions of constraints.txt, with hashes of their files, for every platform
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11.5 --generate-hashes --no-annotate --no-header --extra dev --constraint constraints.txt --output-file constraints.lock pyproject.toml

docs: $(VENV)/.installed-docs ## build the documentation site in runs/site; every link and heading is checked
	$(BIN)/python -m mkdocs build --strict

figures: $(VENV)/.installed-dev ## write the numbers of the pages from docs/results
	$(BIN)/python -m studies.figures
	$(BIN)/python -m studies.defined_pages

size: $(VENV)/.installed-dev ## count lines, files and words (REV=v0.2.0: beside those of that revision)
	$(BIN)/python -m studies.size $(REV)

screenshots: $(VENV)/.installed-dev ## pictures of the report of runs/demo, at two widths, light and dark, in runs/screenshots
	$(BIN)/python -m studies.report_screenshots runs/demo --out runs/screenshots

ablations: $(VENV)/.installed-dev ## train and compare the dilated ConvGRU without each part that the paper names
	$(BIN)/python -m studies.variants ablations

returns: $(VENV)/.installed-demo ## compare kalman without a map of the site, and with the laser's own returns
	$(BIN)/python -m studies.variants returns

junction: $(VENV)/.installed-sim ## simulate the junction's recordings with SUMO (ten minutes)
	$(BIN)/gridtrack simulate junction-set --out data/junction

runs/worlds: | $(VENV)/.installed-sim
	$(BIN)/gridtrack simulate worlds --count 400 --minutes 1.5 --seed 10001 --out $@

weights: $(VENV)/.installed-dev runs/worlds ## train everything in data/weights by its recipe (days of a processor)
	for recipe in studies/recipes/weights/*.toml; do $(BIN)/gridtrack train --recipe $$recipe || exit 1; done

baseline: $(VENV)/.installed-dev ## update the baseline of tests/test_own_trackers.py, after an intended change of a tracker
	rm -rf runs/baseline
	$(COMPARE) $(HALL)@114s-120s $(call chosen,$(HALL_TRACKERS)) --validation $(HALL)@75s-79s \
	    --weights data/weights --horizon 1s --every 0.5s --out runs/baseline
	$(BIN)/gridtrack regress runs/baseline --baseline tests/baselines/own_trackers.json --update
	$(BIN)/pip install --quiet --no-deps --no-build-isolation --target runs/baseline/example $(EXAMPLE)
	PYTHONPATH=runs/baseline/example $(BIN)/python -m pytest -q -c $(EXAMPLE)/pyproject.toml $(EXAMPLE)/tests --gridtrack-update-baseline

clean: ## remove what the other targets made
	rm -rf $(VENV) .link runs build dist *.egg-info

.link/gridtrack: # the tools of lint find the package by it
	mkdir -p .link && ln -sfn .. $@

$(VENV)/.installed-demo: pyproject.toml constraints.txt | $(VENV)
	$(INSTALL) '.[deep,model-free,advection]'
	touch $@

$(VENV)/.installed-sim: pyproject.toml constraints.txt | $(VENV)
	$(INSTALL) '.[sim]'
	touch $@

$(VENV)/.installed-docs: pyproject.toml constraints.txt | $(VENV)
	$(INSTALL) '.[docs]'
	touch $@

$(VENV)/.installed-dev: pyproject.toml constraints.txt | $(VENV)
	$(INSTALL) '.[dev]'
	touch $@ $(VENV)/.installed-demo

$(VENV):
	$(PYTHON) -m venv $(VENV)
