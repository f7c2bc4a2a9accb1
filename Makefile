# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
# Each target works alone in a fresh clone, and reuses what is there.
PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
SOURCES := stereo_speed launch test setup.py tools
# a file of tests stays in one worker, for its tests share what it made; long files come first; a
# worker more than processors, because tests of nodes and commands often wait
CORES := -n $(shell expr $$(env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc) + 1) --dist loadfile --no-loadscope-reorder
# what test-fast leaves out: tests of real nodes, of commands, of whole drives, of drawn scenes
FAST := --ignore=test/integration --ignore=test/cli --ignore=test/lab/cli --ignore=test/nodes \
	--ignore=test/lab/sim
# of make test-pythons: what depends on the versions of Python, numpy and OpenCV
MEASURING := $(addprefix test/,core io geometry vision estimation road site tracking detection \
	second pipeline survey batch)
# of make fuzz
CASES := 20000
# of make soak; in its first minutes tracker_node's memory still fills
MINUTES := 60
GROWTH_MB := 10
# of make faults: faults played to a single node; all that there are where it is empty
FAULTS :=
# and to three nodes; none where it is empty
KILLS := kill_tracker_node kill_stereo_sync_node kill_speed_node
# how many times its limit a silence after a fault may last before the row fails
SLACK := 4
# how often a row that failed is played again; never one with wrong results
AGAIN := 2
# of make release-check: --draft leaves out clean tree and versions
RELEASE :=
# each core has a program of its own already: libraries with a thread for each would wait in turns
ONE_THREAD := OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 OPENCV_FOR_THREADS_NUM=1
TRAFFIC := $(ONE_THREAD) $(PY) -m stereo_speed traffic --minutes 0.35 --vehicles 6 --lanes 2 --seed 8
PLAYED := $(ONE_THREAD) $(PY) -m stereo_speed faults --slack $(SLACK) --again $(AGAIN)

.PHONY: venv browser test test-fast demo bench fuzz soak faults test-pythons lint audit release-check build screenshots clean

venv:
	@bash tools/venv.sh '$(PYTHON)' $(VENV)

# a headless Chromium for the tests of the page, which are skipped without one
browser: venv
	@$(PY) tools/browser.py $(VENV)/browser

test: venv
	@$(PY) tools/browser.py $(VENV)/browser || true
	$(PY) tools/warm_up.py
	$(ONE_THREAD) $(PY) -m pytest -q $(CORES) $(PYTEST_ARGS)

test-fast: venv
	$(ONE_THREAD) $(PY) -m pytest -q -m 'not slow' $(CORES) $(FAST) $(PYTEST_ARGS)

demo: venv
	$(PY) tools/warm_up.py
	$(PY) -m stereo_speed demo --out out

bench: venv
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(PY) -m stereo_speed bench

fuzz: venv
	$(ONE_THREAD) $(PY) -m stereo_speed fuzz --cases $(CASES)

soak: venv
	$(PY) tools/warm_up.py
	$(ONE_THREAD) $(PY) -m stereo_speed endurance soak --minutes $(MINUTES) \
		--growth-mb $(GROWTH_MB) --out out/soak

faults: venv
	$(PY) tools/warm_up.py
	[ -d out/faults ] || $(TRAFFIC) --fps 5 --bag out/faults
	$(if $(FAULTS),,[ -d out/apart ] || $(TRAFFIC) --fps 20 --bag out/apart)
	failed=0; \
	$(PLAYED) out/faults --single $(FAULTS:%=--fault %) || failed=1; \
	$(if $(KILLS),$(PLAYED) out/faults $(KILLS:%=--fault %) || failed=1;) \
	$(if $(FAULTS),,$(PLAYED) out/apart --single --fault exposed_apart || failed=1;) \
	exit $$failed

lint: venv
	$(VENV)/bin/ament_flake8 $(SOURCES)
	$(VENV)/bin/ament_pep257 $(SOURCES)
	$(VENV)/bin/mypy
	$(VENV)/bin/ruff check --quiet $(filter-out test,$(SOURCES))

audit: venv
	$(PY) tools/audit.py

test-pythons:
	bash tools/pythons.sh $(MEASURING)

release-check: venv
	$(PY) tools/release_check.py $(RELEASE)

build: venv
	rm -rf build/colcon
	$(VENV)/bin/colcon --log-base build/colcon/log build --paths . \
		--build-base build/colcon/build --install-base build/colcon/install
	$(PY) tools/check_install.py build/colcon/install/stereo_speed

# the pictures of the page in the documentation
screenshots: browser
	$(ONE_THREAD) $(PY) tools/screenshots.py docs

clean:
	rm -rf $(VENV) $(VENV).lock .venv-* build install log out .pytest_cache .mypy_cache .hypothesis
	find stereo_speed test launch tools -name __pycache__ -type d -prune -exec rm -rf {} +
