# `make demo` and `make test` set up all they need in .venv, once.

# The interpreter to set up on: $PYTHON, else the first of these that fits.
PYTHON ?= $(shell for p in python3 python3.12 python3.11 python3.13 python3.10; do \
  $$p -c 'import sys; sys.exit(not (3, 10) <= sys.version_info < (3, 14))' 2>/dev/null \
  && echo $$p && break; done)
RUN := .venv/bin/python

# The wheels of ROS must not see an installed ROS, nor another environment's settings.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH RMW_IMPLEMENTATION _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport PYTHONDONTWRITEBYTECODE  # or all is compiled anew in each process
export AMENT_PREFIX_PATH := $(CURDIR)/.venv
export ROS_LOG_DIR := $(CURDIR)/build/log
export ROS_HOME := $(CURDIR)/build/ros
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export FASTRTPS_DEFAULT_PROFILES_FILE := $(CURDIR)/config/fastdds_localhost.xml
# What `make inject` plays.
SYSTEM ?= servo
# The matrices are small: more threads only fight over the cores.
export OPENBLAS_NUM_THREADS := 1

.PHONY: help demo test lint inject bench clean set-up

help:
	@echo 'make demo    watch failed sensors being replaced on five systems; build/demo'
	@echo 'make test    the tests but the slow ones (ARGS="-k name": a part; ARGS="-m slow": those)'
	@echo 'make lint    ruff and mypy'
	@echo 'make inject  inject every kind of fault into a replacer (SYSTEM=three_tank; ARGS='--alone --quick')'
	@echo 'make bench   what replacer and designer cost, beside peers (ARGS="--only designer")'
	@echo 'make clean   remove all that make made'

demo: set-up
	@$(RUN) -m vsensor_ros.command.demo --output build/demo $(ARGS)

# Three processes: who plays on a ROS graph often waits. A file's tests share what they design.
test: set-up
	@ROS_PYTHON_CHECK_FIELDS=1 $(RUN) -m pytest -n 3 --dist loadfile -m 'not slow' $(ARGS)

lint: set-up
	@$(RUN) -m ruff check .
	@$(RUN) -m mypy

inject: set-up
	@$(RUN) -m vsensor_ros.command.fault_injection --plant config/$(SYSTEM)/plant.yaml \
	  --params-file config/$(SYSTEM)/replacer.yaml $(ARGS)

bench: set-up
	@$(RUN) -m benchmark $(ARGS)

set-up:
	@command -v '$(PYTHON)' >/dev/null || { \
	  echo 'set-up: no Python 3.10 to 3.13 found: install one, or set PYTHON to its path.' >&2; \
	  exit 1; }
	@$(PYTHON) tools/make_venv.py

clean:
	rm -rf .venv build install log *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
