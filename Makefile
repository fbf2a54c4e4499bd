# Two commands do all of a fresh machine's set-up: `make train` and `make test`.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
PAPER  := curves-sim curves-real rotation noise bias table success-real bias-real sim-to-real exploration

.PHONY: train test test-slow test-ray test-gallery lint docs controllers reproduce paper gallery faults soak benchmark tuning latency limits clean

train: $(VENV)/installed            ## train residual TD3 on the misaligned insertion task, five seeds side by side
	$(BIN)/rrl train trainer.num_seeds=5

test: $(VENV)/installed             ## the default test suite
	$(BIN)/pytest -m "not slow" -n 2 --dist worksteal

test-slow: $(VENV)/installed        ## long training checks
	$(BIN)/pytest -m slow -n 2 --timeout=900

test-ray: $(VENV)/installed         ## experiments on a local Ray
	$(BIN)/pip install --disable-pip-version-check --quiet --constraint constraints.txt --editable ".[ray]"
	$(BIN)/pytest -m slow -k ray

test-gallery: $(VENV)/installed     ## other people's tasks, whose packages it installs
	$(BIN)/pip install --disable-pip-version-check --quiet --constraint constraints.txt --editable ".[gallery]"
	$(BIN)/pytest tests/envs/test_gallery.py
	$(BIN)/pytest -m slow tests/trainers/experiments/test_shipped_experiments.py -k other_peoples

lint: $(VENV)/installed             ## style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(VENV)/installed             ## the reference from the docstrings, in build/reference
	$(BIN)/python docs/reference.py

controllers: $(VENV)/installed      ## score the hand-written controllers on every setting of the task
	$(BIN)/python benchmarks/controllers.py

reproduce: $(VENV)/installed        ## the paper's ten experiments at the quick scale: figures, claims and a report
	$(BIN)/rrl reproduce

paper: $(VENV)/installed            ## the same at the paper's scale, hours: adds what is missing to docs/data/paper, writes docs/results.md
	$(BIN)/rrl reproduce scale=paper data=docs/data/paper
	cp outputs/reproduce/results.md docs/
	cp $(addprefix outputs/reproduce/figures/,$(addsuffix .png,$(PAPER)) $(addsuffix .csv,$(PAPER))) docs/figures/

gallery: $(VENV)/installed          ## other people's tasks, five seeds each: adds what is missing to docs/data/gallery, writes docs/gallery.md
	$(BIN)/pip install --disable-pip-version-check --quiet --constraint constraints.txt --editable ".[gallery]"
	$(BIN)/rrl reproduce gallery data=docs/data/gallery
	cp outputs/reproduce/results-gallery.md docs/gallery.md
	cp outputs/reproduce/figures/gallery.png docs/figures/

faults: $(VENV)/installed           ## kill a training run a hundred times, resume it, compare it with one left in peace
	$(BIN)/python -W ignore benchmarks/faults.py --kills 100

soak: $(VENV)/installed             ## train for ten minutes and watch memory, files, threads and speed
	$(BIN)/python -W ignore benchmarks/soak.py --minutes 10

benchmark: $(VENV)/installed        ## training speed against Stable-Baselines3, SBX, CleanRL's and TorchRL's TD3
	$(BIN)/pip install --disable-pip-version-check --quiet --constraint constraints.txt --editable ".[benchmark]"
	$(BIN)/python -W ignore -m benchmarks.speed
	$(BIN)/python -W ignore -m benchmarks.speed --runs 2

tuning: $(VENV)/installed           ## the hand controller tuned by CMA-ES and Bayesian optimization with as many episodes as a learner has
	$(BIN)/pip install --disable-pip-version-check --quiet --constraint constraints.txt --editable ".[benchmark]"
	$(BIN)/python -W ignore -m benchmarks.tuning

latency: $(VENV)/installed          ## an exported policy beside the trainer's chain: latency, missed deadlines, memory, frozen episodes
	$(BIN)/python -W ignore -m benchmarks.deploy

limits: $(VENV)/installed           ## the worst commands that can be thought of, against the safety limits; goes on where it stopped
	$(BIN)/python -W ignore -m benchmarks.limits --record docs/data/limits.jsonl

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --disable-pip-version-check --quiet --constraint constraints.txt torch
	$(BIN)/pip install --disable-pip-version-check --quiet --constraint constraints.txt --editable ".[dev]"
	touch $@

clean:                              ## remove what the other targets made, but not outputs/
	rm -rf $(VENV) build .pytest_cache .mypy_cache .ruff_cache *.egg-info
