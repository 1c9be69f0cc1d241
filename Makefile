# Everything runs in a virtual environment that the first target to need it makes.
#   PYTHON  the interpreter to make it with     VENV  its folder
PYTHON ?= python3
VENV ?= .venv
# Test processes at a time.
JOBS ?= 2

run = $(VENV)/bin/python
ready = $(VENV)/.ready-$(or $(ROS_DISTRO),wheels)

# The ROS wheels set their library paths once per environment; that of a caller may be another's.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

.DEFAULT_GOAL := help
.PHONY: help venv demo test lint format parameters bench clean

help: ## Print this list
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 12

venv: $(ready) ## Set up the virtual environment (needs the network the first time only)

$(ready): setup.py setup.cfg tools/setup_venv.sh
	@PYTHON='$(PYTHON)' VENV='$(VENV)' sh tools/setup_venv.sh
	@touch $@

demo: $(ready) ## Simulate the paper's fleet, localize it over DDS, write demo.png
	@$(run) -m dg_localization.ros.demo

test: $(ready) ## Run all tests
	$(run) -m pytest -n $(JOBS) $(PYTEST_ARGS)

lint: $(ready) ## Check style and types
	$(run) -m ruff check .
	$(run) -m mypy

format: $(ready) ## Let ruff lay out the code
	$(run) -m ruff check --fix .
	$(run) -m ruff format .

parameters: $(ready) ## Write config/localizer.yaml and docs/parameters.md from the table
	@$(run) -m dg_localization.ros.interface.parameters

bench: $(ready) ## Run the benchmarks against the peers
	@$(run) -m pip install --quiet --no-build-isolation --editable '.[peers]'
	$(run) -m benchmarks

clean: ## Remove the virtual environment and what the tools left
	rm -rf $(VENV) build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis demo.png
	rm -rf *.egg-info
