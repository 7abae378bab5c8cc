# The README's two commands are `make demo` and `make test`; both start from a bare Python 3.11.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV ?= .venv
BIN := $(VENV)/bin
DEMO := data/leg_tracker/leg_tracker.mcap
JUNCTION := $(wildcard data/junction/test-*.tracks)
TRACKERS := persistence static-map blank kalman dogma deep-tracking-rnn dilated-convgru

.PHONY: demo demo-junction results returns ablations junction test lint bench baseline weights clean

demo: $(VENV)/.installed-demo
	rm -rf runs/demo
	$(BIN)/gridtrack compare $(DEMO) $(TRACKERS:%=--tracker %) --every 0.5s --latency --out runs/demo

# Twenty minutes at a simulated junction whose truth is known; ships as tracks and needs no simulator.
demo-junction: $(VENV)/.installed-demo
	rm -rf runs/junction
	$(BIN)/gridtrack compare $(JUNCTION) --validation data/junction/validation.tracks \
	    $(foreach tracker,persistence static-map blank kalman factor-graph dogma dilated-convgru one-shot,--tracker $(tracker)) --out runs/junction

# Every tracker on those twenty minutes: the figures of docs/results/junction.
results: $(VENV)/.installed-demo
	rm -rf runs/results
	$(BIN)/gridtrack compare $(JUNCTION) --validation data/junction/validation.tracks \
	    $(foreach tracker,persistence static-map blank kalman factor-graph dogma one-shot deep-tracking-rnn dilated-convgru,\
        --tracker $(tracker)) \
	    --reference dilated-convgru --out runs/results
	$(BIN)/python -m studies.static_memory

# The dilated ConvGRU without each of the parts that the paper names, by the recipes in studies/recipes/ablations.
ablations: $(VENV)/.installed-dev
	$(BIN)/python -m studies.ablations

# The pipeline without a map of the site, and with the laser's own returns.
returns: $(VENV)/.installed-demo
	$(BIN)/python -m studies.returns

# The set that the demo is run on, made again with SUMO (about ten minutes on two cores).
junction: $(VENV)/.installed-sim
	$(BIN)/gridtrack simulate junction-set --out data/junction

test: lint
	$(BIN)/python -m pytest -n auto --dist worksteal

EXAMPLE := examples/example_tracker
lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell
	mkdir -p .link && ln -sfn .. .link/gridtrack
	MYPYPATH=.link $(BIN)/mypy -p gridtrack
	MYPYPATH=.link:$(EXAMPLE):$(EXAMPLE)/tests $(BIN)/mypy -m example_tracker -m test_example_tracker
	PYTHONPATH=.link $(BIN)/lint-imports

# Those that need nothing but what `make test` installs; the others say in their first lines what they ask for.
BENCHMARKS := import_time raycast scoring harness recurrent inference dogma model_free estimators \
    hour
bench: $(VENV)/.installed-dev
	for benchmark in $(BENCHMARKS); do $(BIN)/python -m benchmarks.$$benchmark || exit 1; done

# What our own trackers are held against by tests/test_own_trackers.py: after a change that is meant to change them.
baseline: $(VENV)/.installed-dev
	rm -rf runs/baseline
	$(BIN)/gridtrack compare $(DEMO)@114s-124s $(TRACKERS:%=--tracker %) --validation $(DEMO)@75s-81s \
	    --weights data/weights --horizon 1s --every 0.5s --out runs/baseline
	$(BIN)/gridtrack regress runs/baseline --baseline tests/baselines/own_trackers.json --update

# What ships in data/weights, by the recipes in studies/recipes/weights (five hours on two cores).
weights: $(VENV)/.installed-dev
	for recipe in studies/recipes/weights/*.toml; do $(BIN)/gridtrack train --recipe $$recipe || exit 1; done

$(VENV)/.installed-demo: pyproject.toml constraints.txt | $(VENV)
	$(BIN)/pip install --constraint constraints.txt --editable '.[deep,model-free]'
	touch $@

$(VENV)/.installed-sim: pyproject.toml constraints.txt | $(VENV)
	$(BIN)/pip install --constraint constraints.txt --editable '.[sim]'
	touch $@

$(VENV)/.installed-dev: pyproject.toml constraints.txt | $(VENV)
	$(BIN)/pip install --constraint constraints.txt --editable '.[dev]'
	touch $@ $(VENV)/.installed-demo

$(VENV):
	$(PYTHON) -m venv $(VENV)

clean:
	rm -rf $(VENV) .link runs build dist *.egg-info
