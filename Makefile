# `make` lists the targets. `make test` is what CI runs.

PYTHON ?= $(firstword $(shell command -v python3.11) python3)
BIN := .venv/bin
PACKAGES := runtime services hardware_sim dashboard experiments
STAMP := .venv/.installed
SHORT := --methods "(i),(ii),(iii),(iv),(iv) network"
KEPT := $(or $(XDG_STATE_HOME),$(HOME)/.local/state)/myograft/experiments

.DEFAULT_GOAL := help
.PHONY: help setup demo test check format bench docs pictures schemas experiments clean

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  \1\t\2/p' $(MAKEFILE_LIST) | expand -t 16

setup: $(STAMP)  ## make .venv with everything in it

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt \
		--editable ".[sim,learn,view,web,cluster,dev]"
	$(BIN)/python -c "import hardware_sim.robot"  # compiles, so that the first start need not
	touch $@

demo: setup  ## the whole story in one go: three muscles, a fourth is plugged in, the arm relearns
	$(BIN)/myograft demo

check: setup  ## format, lint, types, floors
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: check  ## check, then every test
	OMP_NUM_THREADS=1 $(BIN)/pytest --quiet --durations=5 --numprocesses 2 --dist loadfile \
		tests/unit tests/contracts
	$(BIN)/pytest --quiet --durations=5 tests/integration tests/e2e

format: setup  ## put the code into shape
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: setup  ## measure the budgets
	$(BIN)/pytest --quiet --capture=no tests/bench

docs: setup  ## the reference, made from the code
	$(BIN)/python -m docs.reference

pictures: docs  ## the documents' pictures and tables, made anew
	mkdir -p docs/pictures
	$(BIN)/myograft demo --picture docs/pictures/demo.png --json docs/pictures/demo.json
	$(BIN)/myograft view elbow --picture docs/pictures/view.png --at 63
	shots=$$(mktemp -d) && ARTIFACTS=$$shots $(BIN)/pytest --quiet tests/e2e/test_page.py \
		&& cp $$shots/growing.png docs/pictures/page.png
	$(BIN)/myograft demo musashi_w --picture docs/pictures/lift.png --json docs/pictures/lift.json
	$(BIN)/python -m docs.results

schemas: setup  ## make the shipped schemas anew; half an hour
	for robot in elbow musashi_arm musashi_w; do $(BIN)/python -m experiments learn $$robot || exit 1; done
	for robot in musashi_arm musashi_w; do \
		$(BIN)/python -m experiments learn $$robot --drawing-off-mm 20 || exit 1; done

experiments: setup  ## repeat the experiments; hours, and it goes on where it stopped
	$(BIN)/python -m experiments elbow --seed 200 --json docs/results/elbow.json
	$(BIN)/python -m experiments elbow --variants moved2,moved4,stiff,motor,soft,load \
		$(SHORT) --controls converged --out $(KEPT)/elbow-variants \
		--json docs/results/elbow-variants.json
	$(BIN)/python -m experiments arm --variants clean,model --seed 200 $(SHORT) --json docs/results/arm.json
	$(BIN)/python -m experiments arm --variants moved2,moved4,stiff,motor,soft,load,all --seed 200 $(SHORT) \
		--controls converged --out $(KEPT)/arm-variants --json docs/results/arm-variants.json
	$(BIN)/python -m experiments lift --variants clean,model --seed 200 --json docs/results/lift.json
	$(BIN)/python -m experiments lift --variants moved2,moved4,stiff,motor,soft,load --seed 200 \
		--seeds 3 --out $(KEPT)/lift-variants --json docs/results/lift-variants.json
	$(BIN)/python -m experiments ablate elbow --seeds 5 --json docs/results/ablate-elbow.json
	$(BIN)/python -m experiments ablate arm --seeds 5 --variants model --json docs/results/ablate-arm.json
	$(BIN)/python -m experiments estimate elbow --seeds 10 --seed 200 --json docs/results/estimate-elbow.json
	$(BIN)/python -m experiments estimate musashi_arm --seeds 5 --seed 200 --json docs/results/estimate-arm.json

clean:  ## remove what was built, keep .venv
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find $(PACKAGES) tests -name __pycache__ -type d -prune -exec rm -rf {} +
