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

# What the paper claims of its network taken away, one claim at a time, each trained with 625 updates.
SHORT := burn_in=10,validate_every=125,warm_up=50,learning_rate=0.004,updates=625,stage=occupancy
BLANKS := shown=10,blank=20,cycles=1
ABLATIONS := whole:$(BLANKS) no-static-memory:$(BLANKS),static_gates=[] no-dilation:$(BLANKS),dilated=false \
    no-gates:$(BLANKS),cell=plain papers-scheme:shown=10,blank=10,cycles=2
ablations: $(VENV)/.installed-dev
	for each in $(ABLATIONS); do \
	    $(BIN)/gridtrack train "dilated-convgru:$(SHORT),$${each#*:}" $(AT_JUNCTION)@0s-90s \
	        --out runs/trained/$${each%%:*} || exit 1; done
	rm -rf runs/ablations
	$(BIN)/gridtrack compare $(JUNCTION) --validation data/junction/validation.tracks --tracker persistence \
	    $(foreach each,$(ABLATIONS),--tracker $(firstword $(subst :, ,$(each)))=dilated-convgru:weights=runs/trained/$(firstword $(subst :, ,$(each)))) \
	    --every 2s --reference whole --out runs/ablations

# The pipeline without a map of the place, and with the laser's own returns: what of their settings differs was searched for.
RETURNS := link_m=0.264,surface_m=0.08,return_noise_m=0.03
returns: $(VENV)/.installed-demo
	rm -rf runs/returns
	$(BIN)/gridtrack compare $(JUNCTION) --validation data/junction/validation.tracks --tracker kalman \
	    --tracker cold=kalman:background=none --tracker raw=kalman:points=raw,$(RETURNS) --reference kalman --out runs/returns

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

# What ships in data/weights, made again (five hours on two cores).
GRU := shown=10,blank=20,cycles=1,reverse=true,updates=1500,validate_every=100,learning_rate=0.005,warm_up=20
RNN := shown=20,blank=20,cycles=1,reverse=true,superpose=true,updates=1000,validate_every=100,learning_rate=0.003,warm_up=100
RNN_AT_JUNCTION := burn_in=20,shown=20,blank=20,cycles=1,validate_every=250,warm_up=100,learning_rate=0.003,updates=4000
GRU_AT_JUNCTION := burn_in=10,shown=10,blank=20,cycles=1,validate_every=250,warm_up=50,learning_rate=0.004,updates=4000
AT_JUNCTION := data/junction/train.tracks --validation data/junction/validation.tracks
THREE_STRETCHES := $(foreach each,0s-320s 1300s-1620s 2600s-2920s,data/junction/train.tracks@$(each)) \
    --validation data/junction/validation.tracks@0s-96s
# The settings of a street that searches begin from: of the three best of a longer search the one that did best on the
# validation recording (docs/trackers/model-free.md). `train kalman` without them searches for itself.
STREET = $$($(BIN)/python -c 'from gridtrack.trackers.model_free.tuning import STARTS; \
    print(",".join(f"{key}={value}" for key, value in STARTS[1].model_dump(exclude_unset=True).items()))')

weights: $(VENV)/.installed-dev
	for tracker in static-map kalman factor-graph dogma deep-tracking-rnn:$(RNN) dilated-convgru:$(GRU); do \
	    $(BIN)/gridtrack train $$tracker $(DEMO) --out data/weights || exit 1; done
	$(BIN)/gridtrack train static-map $(AT_JUNCTION) --out data/weights
	for tracker in kalman factor-graph; do \
	    $(BIN)/gridtrack train $$tracker:$(STREET),stage=occupancy $(AT_JUNCTION)@0s-96s --out data/weights || exit 1; done
	$(BIN)/gridtrack train dogma $(THREE_STRETCHES) --out data/weights
	$(BIN)/gridtrack train deep-tracking-rnn:$(RNN_AT_JUNCTION) $(AT_JUNCTION)@0s-90s --out data/weights
	for tracker in dilated-convgru:$(GRU_AT_JUNCTION),stage=occupancy \
	    $(foreach each,dilated-convgru kalman factor-graph,$(each):stage=classes) one-shot; do \
	    $(BIN)/gridtrack train $$tracker $(AT_JUNCTION)@0s-90s --seed 1 --out data/weights || exit 1; done

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
