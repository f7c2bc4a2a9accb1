# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
# Each target works alone in a fresh clone, and reuses what is there.
PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
SOURCES := stereo_speed launch test setup.py tools
# a file of tests stays on one core, for its tests share what it made
CORES := -n auto --dist loadfile
# what test-fast leaves out: tests of real nodes, of commands, of whole drives, of drawn scenes
FAST := --ignore=test/integration --ignore=test/cli --ignore=test/lab/cli --ignore=test/nodes \
	--ignore=test/lab/sim
# each core has a program of its own already: libraries with a thread for each would wait in turns
ONE_THREAD := OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 OPENCV_FOR_THREADS_NUM=1

.PHONY: venv test test-fast demo bench lint build clean

venv:
	@bash tools/venv.sh '$(PYTHON)' $(VENV)

test: venv
	$(ONE_THREAD) $(PY) -m pytest -q $(CORES) $(PYTEST_ARGS)

test-fast: venv
	$(ONE_THREAD) $(PY) -m pytest -q -m 'not slow' $(CORES) $(FAST) $(PYTEST_ARGS)

demo: venv
	$(PY) -m stereo_speed demo --out out

bench: venv
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(PY) -m stereo_speed bench

lint: venv
	$(VENV)/bin/ament_flake8 $(SOURCES)
	$(VENV)/bin/ament_pep257 $(SOURCES)
	$(VENV)/bin/mypy

build: venv
	rm -rf build/colcon
	$(VENV)/bin/colcon --log-base build/colcon/log build --paths . \
		--build-base build/colcon/build --install-base build/colcon/install
	$(PY) tools/check_install.py build/colcon/install/stereo_speed

clean:
	rm -rf $(VENV) build install log out .pytest_cache .mypy_cache
	find stereo_speed test launch tools -name __pycache__ -type d -prune -exec rm -rf {} +
