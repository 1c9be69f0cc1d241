# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

# Everything runs in a virtual environment that the first target to need it makes.
#   PYTHON  the interpreter to make it with    VENV  its folder    JOBS  test processes at a time
PYTHON ?= python3
VENV ?= .venv
JOBS ?= 2

# Where ROS 2 is sourced its packages are used; elsewhere they come as wheels.
ros = $(or $(ROS_DISTRO),wheels)
# Packages that have no wheels.
built = empy
extras = bags bench dask lint plots progress speed test
ready = $(VENV)/.ready-$(ros)
run = $(VENV)/bin/python

# The ROS wheels set their library paths once per environment; that of a caller may be another's.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
export PIP_DISABLE_PIP_VERSION_CHECK = 1

.DEFAULT_GOAL := help
.PHONY: help venv demo test lint format docs requirements bench clean
# Each recipe is one script that ends at its first error.
.ONESHELL:
.SHELLFLAGS = -ec

help: ## Print this list
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 12

venv: $(ready) ## Set up the virtual environment and compile (needs the network the first time only)

# Packages are those of requirements/, by version and hash, and wheels except for `built`: nothing of
# a download is run before its hash is checked. They are kept in a folder inside pip's cache and are
# tried first, so that another clone on the same machine needs no network. (pip's own HTTP cache asks
# the package index again each time.)
$(ready): setup.py setup.cfg $(wildcard requirements/*.txt)
	@fail() { printf '%s\n' "$$@" >&2; exit 1; }
	command -v $(PYTHON) >/dev/null ||
	    fail 'PYTHON=$(PYTHON): not found; install python3 and python3-venv.'
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
	    fail "PYTHON=$(PYTHON) is $$($(PYTHON) -V); this package needs Python 3.11 or newer."
	[ ! -e $(VENV) ] || [ -f $(VENV)/pyvenv.cfg ] ||
	    fail 'VENV=$(VENV) exists and is no virtual environment.'
	case $(ros) in
	wheels)
	    options= ;;
	jazzy | lyrical)
	    $(PYTHON) -c 'import rclpy' || fail \
	        "ROS 2 $(ros) is sourced, but PYTHON=$(PYTHON) ($$($(PYTHON) -V)) cannot import rclpy." \
	        'Use the Python it was built for (PYTHON=/usr/bin/python3) or a shell without ROS.'
	    options=--system-site-packages ;;
	*)
	    fail 'ROS_DISTRO=$(ros) is sourced; this package is for jazzy and lyrical.' \
	        'Use a shell where one of these, or no ROS at all, is sourced.' ;;
	esac
	version=$$($(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
	echo "Making $(VENV) with Python $$version (ROS 2: $(ros))"
	$(PYTHON) -m venv --clear $$options $(VENV) ||
	    fail '$(PYTHON) -m venv failed; on Debian and Ubuntu: apt install python3-venv'
	cache=$$($(run) -m pip cache dir 2>/dev/null) || cache=$${XDG_CACHE_HOME:-$$HOME/.cache}/pip
	wheels=$$cache/dg_localization/$(ros)-$$version
	mkdir -p "$$wheels"
	pip() {
	    command=$$1; shift
	    $(run) -m pip $$command -q --no-deps --no-build-isolation --require-hashes "$$@"
	}
	provide() {
	    file=$$1
	    pip install --no-index --find-links "$$wheels" -r $$file 2>/dev/null || {
	        echo "Fetching packages into $$wheels"
	        rm -f $(built:%="$$wheels"/%-*.whl)
	        pip download -d "$$wheels" --find-links "$$wheels" \
	            --only-binary=:all: --no-binary=$(built) -r $$file ||
	            fail 'Packages could not be fetched: the first set-up needs the network.'
	        pip install --no-index --find-links "$$wheels" -r $$file
	    }
	}
	provide requirements/build.txt
	# Kernels are compiled by one processor while the other installs what they do not need.
	sed -n '/^\(llvmlite\|numba\|numpy\)==/,/# via/p' requirements/$(ros).txt >$(VENV)/numba.txt
	provide $(VENV)/numba.txt
	$(run) -m dg_localization.compile_kernels &
	kernels=$$!
	provide requirements/$(ros).txt
	$(run) -m pip install -q --no-index --no-deps --no-build-isolation --editable .
	wait $$kernels || :
	touch $@
	echo 'Ready: $(VENV)'

demo: $(ready) ## Simulate the paper's fleet, localize it over DDS, write demo.png
	@$(run) docs/demo.py

# Kernels that have changed are compiled first, with progress: a test that waits would time out.
# Pytest loads NumPy before this package can limit its threads, which hinder those of other processes.
test: $(ready) ## Run all tests
	$(run) -m dg_localization.compile_kernels || :
	OPENBLAS_NUM_THREADS=1 $(run) -m pytest -n $(JOBS) --dist worksteal $(PYTEST_ARGS)

lint: $(ready) ## Check style and types
	$(run) -m ruff check .
	$(run) -m ruff format --check .
	$(run) -m mypy

format: $(ready) ## Let ruff lay out the code
	$(run) -m ruff check --fix .
	$(run) -m ruff format .

docs: $(ready) ## Build the pages of docs/ as HTML in build/docs
	@$(run) -m pip install -q --no-deps --no-build-isolation --require-hashes -r requirements/docs.txt
	$(run) -m sphinx -q -W -n docs build/docs

# On a machine with ROS 2 numpy is that of the system, which ROS was compiled against.
requirements: ## Pin the newest packages that setup.py allows (needs the network)
	@tools=$$(mktemp -d)
	trap 'rm -rf "$$tools"' EXIT
	$(PYTHON) -m venv "$$tools"
	"$$tools/bin/python" -m pip install -q uv
	pin() { out=requirements/$$1.txt; shift
	    "$$tools/bin/uv" pip compile -q --universal --generate-hashes --upgrade \
	        --custom-compile-command 'make requirements' --python-version 3.11 \
	        -o $$out "$$@"; }
	common="setup.py $(extras:%=--extra %)"
	pin build requirements/build.in
	pin wheels $$common --extra ros
	pin jazzy $$common -c requirements/jazzy.in --no-emit-package numpy
	pin lyrical $$common --no-emit-package numpy
	pin colcon setup.py --extra colcon --no-emit-package numpy
	pin docs setup.py --extra docs -c requirements/wheels.txt --no-emit-package numpy

bench: $(ready) ## Compare with other methods
	@$(run) -m pip install -q --no-build-isolation --editable '.[compare]'
	$(run) -m benchmarks

clean: ## Remove the virtual environment and what the tools left
	rm -rf $(VENV) build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis demo.png
	rm -rf *.egg-info
