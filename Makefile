# Everything runs in .venv; nothing else on the machine is touched.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# DDS stays on this machine.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export OMP_NUM_THREADS := 1

.PHONY: demo test lint types unit bench soak docs clean

demo: $(VENV)/.demo
	@$(BIN)/magcal demo

test: lint types unit

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.test
	$(BIN)/mypy

unit: $(VENV)/.test
	$(BIN)/python -c "import rclpy"
	$(BIN)/python -m pytest --numprocesses 2 --dist loadfile --ignore test/ros
	$(BIN)/python -m pytest test/ros

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

$(VENV)/bin/pip:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/.demo: setup.py | $(VENV)/bin/pip
	$(BIN)/python -m pip install --quiet --editable '.[ros,report,live]'
	@touch $@

$(VENV)/.test: setup.py | $(VENV)/bin/pip
	$(BIN)/python -m pip install --quiet --editable '.[ros,test]'
	@touch $@ $(VENV)/.demo

docs: $(VENV)/.test
	$(BIN)/python -m magcal_ros.ros.generated README.md config/calibrator.yaml

clean:
	rm -rf $(VENV) build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis *.egg-info
