# `make demo` and `make test` work on a fresh Debian or Ubuntu with python3 >= 3.11, its venv module and make.
SHELL := /bin/bash
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
RECIPE := setup.py setup.cfg pyproject.toml

# With ROS 2 Jazzy sourced its own rclpy and Ubuntu's numpy, scipy, ... are used: the venv sees the system's packages
# and gets only what is missing. UNTESTED where this is developed: apt ROS cannot be had there.
ROS_SOURCED := $(shell [ "$$ROS_DISTRO" = jazzy ] && /usr/bin/python3 -c 'import rclpy' 2>/dev/null && echo yes)
ifeq ($(ROS_SOURCED),yes)
  PYTHON ?= /usr/bin/python3
  VENV_FLAGS := --system-site-packages
else
  PYTHON ?= $(shell for p in python3.12 python3.11 python3; do \
    $$p -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && echo $$p && break; done)
endif

.PHONY: help demo test check format bench golden studies firmware clean
help:  ## this list
	@sed -n 's/^\([a-z]*\):.*## /  make \1  \t/p' $(firstword $(MAKEFILE_LIST)) | expand -t 18

demo: $(VENV)/.core  ## run the whole graph on the simulated six-wheel rover; bag, report, picture
	$(BIN)/strap_rover demo

test: $(VENV)/.test  ## the whole test suite
	$(BIN)/python -m pytest -n 2 --dist loadgroup test

check: $(VENV)/.test  ## format, lint, types, import rules, spelling
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/codespell

format: $(VENV)/.test  ## bring the code into the house format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(VENV)/.core  ## speed of plant, estimator, parser, graph
	$(BIN)/python -m benchmarks

golden: $(VENV)/.test  ## write the golden CSVs anew; review the difference before committing it
	$(BIN)/python -m pytest test/golden --write-golden

studies: $(VENV)/.core  ## every case study beside the paper's numbers (minutes)
	$(BIN)/strap_rover case_study all

firmware:  ## the strap board's firmware (ELF, HEX) and, with libsimavr, the simulated Uno: build/firmware
	@$(MAKE) --no-print-directory -C firmware

clean:  ## remove environment, builds, output, caches
	rm -rf $(VENV) build install log out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis \
	  .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Each stamp is written when its step is whole: an interrupted step is done again, a finished one is not.
$(VENV)/.made:
	@test -n "$(PYTHON)" || { echo "No Python >= 3.11 with venv found. On Debian or Ubuntu:" \
	  "sudo apt install python3 python3-venv; or name one: make PYTHON=/path/to/python3.12" >&2; exit 1; }
	@echo "[1/3] making $(VENV) with $(PYTHON)$(if $(VENV_FLAGS), and the packages of ROS 2 $(ROS_DISTRO))"
	@rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV_FLAGS) $(VENV)
	@touch $@

ifeq ($(ROS_SOURCED),yes)
$(VENV)/.core: $(VENV)/.made $(RECIPE)
	@echo "[2/3] installing what ROS 2 and Ubuntu do not have"
	@$(PIP) -e '.[report]'
	@touch $@
else
$(VENV)/.core: $(VENV)/.made requirements/core.txt requirements/constraints.txt $(RECIPE)
	@echo "[2/3] installing rclpy, numpy, numba, ... (about 300 MB, under a minute on a good line)"
	@$(PIP) -r requirements/core.txt
	@echo "[3/3] installing strap_rover itself, editable"
	@$(PIP) --no-deps -e .
	@touch $@
endif

$(VENV)/.test: $(VENV)/.core requirements/test.txt
	@echo "[+] installing pytest, ruff, mypy, colcon, ..."
	@$(PIP) -r requirements/test.txt
	@touch $@
