# Everything runs in .venv; nothing else on the machine is touched.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# DDS stays on this machine.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
ifeq ($(ROS_DISTRO),humble)
export ROS_LOCALHOST_ONLY := 1
endif
export OMP_NUM_THREADS := 1
# The tests start many processes; without compiled files each would compile the package anew.
unexport PYTHONDONTWRITEBYTECODE

# uv installs in a third of pip's time. Where uv is not to be had, or does not find the index that
# pip is configured for, pip installs, and says what fails. Errors only: setuptools warns of every
# editable installation. Python compiles what is imported when it is.
PIP := $(BIN)/python -m pip install --quiet --quiet --no-compile
UV := $(BIN)/uv pip install --quiet --python $(BIN)/python
INSTALL := install() { $(UV) "$$@" 2>/dev/null || $(PIP) "$$@"; }; install

# An idle task is interrupted as soon as a test of ROS has something to do; one that is merely nice
# first uses up its time slice, thousands of times.
AFTER_OTHERS := nice -n 15 $(shell chrt --idle 0 true 2>/dev/null && echo chrt --idle 0)
BY_TWO := --numprocesses 2 --dist worksteal
BY_THREE := --numprocesses 3 --dist worksteal

# Each process would rewrite the asserts of all tests, to say more where one fails: seconds of a
# core. Instead what failed runs once more with the words, and has failed all the same.
PLAIN := --assert=plain
ALONE := --last-failed --last-failed-no-failures none

.PHONY: demo test lint types without_ros unit ros nightly bench soak matrix docs pictures clean

demo: $(VENV)/.demo
	@$(BIN)/magcal demo --speed 4

# The tests of ROS mostly wait, and so does pip. The other tests run meanwhile at lower priority.
test:
	$(MAKE) --jobs 4 --output-sync=target ros unit lint types

lint: $(VENV)/.test
	$(AFTER_OTHERS) $(BIN)/ruff check .
	$(AFTER_OTHERS) $(BIN)/ruff format --check .

# The package. `make nightly` checks what measures it and what makes its cases, too.
types: $(VENV)/.test
	$(AFTER_OTHERS) $(BIN)/mypy magcal_ros

PYTEST := $(BIN)/python -m pytest -q -o cache_dir=.pytest_cache/

# These tests need no ROS and begin while it is being installed.
WITHOUT_ROS := test/core test/files test/report
WITHOUT_ROS_TESTS := $(AFTER_OTHERS) $(PYTEST)without_ros $(WITHOUT_ROS)
UNIT_TESTS := $(AFTER_OTHERS) $(PYTEST)unit test $(WITHOUT_ROS:%=--ignore %) --ignore test/ros

without_ros: $(VENV)/.without_ros
	$(WITHOUT_ROS_TESTS) $(PLAIN) $(BY_TWO) || { $(WITHOUT_ROS_TESTS) $(ALONE); exit 1; }

unit: without_ros $(VENV)/.test
	$(UNIT_TESTS) $(PLAIN) $(BY_TWO) || { $(UNIT_TESTS) $(ALONE); exit 1; }

# A robot that turns itself is stopped, rightly, when the machine stalls for .3 s. A test that
# this ended, by the node's own words, is run again; a test that failed otherwise is not.
STALLED := --reruns 3 --only-rerun 'keeps? the machine busy'

# What failed beside the other jobs is run once more alone: a fault of ours fails again.
ROS_TESTS := $(PYTEST)ros test/ros

# Each process has a DDS domain of its own.
ros: $(VENV)/.test
	$(BIN)/python -c "import rclpy"
	$(ROS_TESTS) $(PLAIN) $(BY_THREE) $(STALLED) || $(ROS_TESTS) $(ALONE)

# Everything once more, with statistics over many seeds and ten times as many random cases.
nightly: $(VENV)/.test
	$(BIN)/mypy
	$(BIN)/python -m pytest -m '' --hypothesis-profile nightly --timeout=1800
	$(BIN)/python benchmarks/soak.py --hours 0.5 --rate 400

bench: $(VENV)/.test
	$(BIN)/python benchmarks/cost.py
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/offline.py
	$(BIN)/python benchmarks/accuracy.py
	$(BIN)/python benchmarks/honesty.py
	$(BIN)/python benchmarks/moving.py

# Hours: every fault of doc/faults.md tried for long, then a day of messages.
soak: $(VENV)/.test
	MAGCAL_SOAK=1 $(BIN)/python -m pytest -m faults --timeout=14400
	$(BIN)/python benchmarks/soak.py --hours 24

# Every Python and every set of libraries (noxfile.py), each with a venv of its own in .nox/.
matrix: $(VENV)/.nox
	$(BIN)/nox

$(VENV)/bin/pip:
	@echo "Setting up $(VENV), once: half a minute, most of it for rclpy of ROS 2 Jazzy"
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) uv || $(PIP) --upgrade pip

$(VENV)/.demo: setup.py | $(VENV)/bin/pip
	@$(INSTALL) --editable '.[bags,ros,report,live]'
	@touch $@

$(VENV)/.without_ros: setup.py | $(VENV)/bin/pip
	@$(INSTALL) --editable '.[test-without-ros]'
	@touch $@

# By its name: tests that run already import the package, which must not be installed anew.
$(VENV)/.test: $(VENV)/.without_ros
	@$(INSTALL) 'magcal_ros[ros,test]'
	@touch $@ $(VENV)/.demo

$(VENV)/.docs: setup.py | $(VENV)/bin/pip
	@$(INSTALL) --editable '.[ros,docs]'
	@touch $@

$(VENV)/.nox: | $(VENV)/bin/pip
	@$(INSTALL) nox
	@touch $@

# The generated parts of pages and files, then the site of the pages in build/docs.
docs: $(VENV)/.docs
	$(BIN)/python doc/generate.py
	$(BIN)/python -m sphinx -q -W doc build/docs

# The pictures of the pages, drawn by Chromium from simulated sensors.
pictures: $(VENV)/.test
	$(BIN)/python doc/pictures.py

clean:
	rm -rf $(VENV) .nox dist build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis *.egg-info
