# make demo: from nothing to a calibrated virtual machine.  make test: from nothing to passed tests.
# PYTHON=/path/to/python3.12 names a Python, VENV=/path another place for the environment.

VENV ?= .venv
WORKERS ?= 2
BIN := $(VENV)/bin
HASHES ?=
SETUP = python=$$(PYTHON="$(PYTHON)" sh tools/find_python.sh) && "$$python" tools/setup_env.py --venv "$(VENV)" $(if $(HASHES),--hashes)

.PHONY: setup setup-tests demo test test-long test-floor lint bench blind fuzz linuxcnc-test browser-test ros-workspace sbom lock clean

setup:
	@$(SETUP)

setup-tests:
	@$(SETUP) --tests

demo: setup
	@$(BIN)/stepdiag demo

test: setup-tests
	$(BIN)/python -m pytest -n $(WORKERS) $(ARGS)

# What takes longer than a change should wait for; before a release.
test-long: setup-tests
	$(BIN)/python -m pytest -n $(WORKERS) -m long $(ARGS)

# With the oldest libraries that work (requirements/floor.txt), in an environment of its own: what computes, reads,
# writes and talks to instruments, and one calibration through the running nodes.  Not what takes long and computes
# nothing that others do not: comparisons of one evaluation with another, faults of mounting, ways beside the plan,
# and what is told of an evaluation besides the errors.
FLOOR ?= build/floor
FLOOR_TESTS ?= test/unit/estimate test/unit/bag test/unit/devices test/unit/report/test_figures.py \
	$(addprefix --ignore=test/unit/estimate/test_,knowing_less.py sanity.py overrun_and_targets.py stations.py three_face.py \
	closure.py metres.py of_ways.py shared.py workpiece.py) \
	$(addprefix test/unit/virtual/,test_modbus.py test_live_is_offline.py test_sampled.py test_noise.py test_world.py) \
	test/node/test_calibration.py::test_live_replayed_and_read_have_the_same_bits
test-floor:
	@python=$$(PYTHON="$(PYTHON)" sh tools/find_python.sh) && "$$python" tools/setup_env.py --venv "$(FLOOR)" --tests --floor
	$(FLOOR)/bin/python -m pytest -n $(WORKERS) $(FLOOR_TESTS) $(ARGS)

lint: setup-tests
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/mypy

bench: setup-tests
	@for bench in bench/bench_*.py; do echo "== $$bench"; $(BIN)/python $$bench || exit 1; done

# The whole blind check, an hour or two: SEED=... draws other logs.
SEED ?= 20261121
blind: setup
	$(BIN)/stepdiag blind seal --seed $(SEED) --null 300 --single 285 --pair 60 --outside 77 --out build/blind-$(SEED)
	$(BIN)/stepdiag blind answer build/blind-$(SEED)
	$(BIN)/stepdiag blind open --floor --apart --settle build/blind-$(SEED)

# Hostile inputs, drawn for TIME seconds (KINDS="bag cell": of these kinds); what is found stands in build/fuzz.
TIME ?= 600
fuzz: setup-tests
	nice -n 10 $(BIN)/python test/fuzz/fuzz.py --seconds $(TIME) $(if $(KINDS),--kinds $(KINDS))

# A bill of materials of the environment (CycloneDX), and the hashes of all that is installed.
sbom: setup
	@$(BIN)/python tools/supply.py sbom

lock: setup
	@$(BIN)/python tools/supply.py lock

# Both packages side by side in a ROS workspace, for colcon, rosdep and bloom: WS=/path/to/ws [COPY=1].
ros-workspace:
	@test -n "$(WS)" || { echo "ros-workspace: name the workspace: make ros-workspace WS=/path/to/ws" >&2; exit 2; }
	@python3 tools/ros_workspace.py $(if $(COPY),--copy) "$(WS)"

# The optional parts.  What they need besides: sudo apt-get install linuxcnc-uspace / chromium
linuxcnc-test: setup-tests
	$(BIN)/python -m pytest -rs -m linuxcnc $(ARGS)

browser-test: setup-tests
	$(BIN)/python -m pytest -rs -m browser $(ARGS)

clean:
	rm -rf "$(VENV)" "$(VENV).lock" build install log .pytest_cache .ruff_cache .mypy_cache .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +
	rm -rf *.egg-info
