# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The processes around live nodes."""
from __future__ import annotations

import os
import time

from stereo_speed.lab.cli.live_graph import Burner, confined, processor_s

DEADLINE_S = 20.0


def test_burner_keeps_a_core_busy_and_ends():
    with Burner() as burner:
        end_s = time.monotonic() + DEADLINE_S
        while processor_s(burner.process.pid) < 0.2 and time.monotonic() < end_s:
            time.sleep(0.05)
        assert processor_s(burner.process.pid) >= 0.2 and burner.process.poll() is None
    assert burner.process.returncode is not None and burner.process.returncode < 0


def test_processes_are_confined_to_one_core_and_their_starter_is_not():
    cores = os.sched_getaffinity(0)
    with confined(), Burner() as burner:
        where = os.sched_getaffinity(burner.process.pid)
    assert where == {min(cores)} and os.sched_getaffinity(0) == cores
    with confined(False), Burner() as burner:
        assert os.sched_getaffinity(burner.process.pid) == cores
