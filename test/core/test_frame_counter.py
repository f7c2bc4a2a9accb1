# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Frame numbers from stamps: with jitter and drops, by hand, and after a jump."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.core.frame_counter import FrameCounter

MS = 1_000_000
JUMP_NS = 1000 * MS


@pytest.fixture()
def counter():
    """Return a counter that takes a step back of one second for a jump."""
    return FrameCounter(JUMP_NS)


def test_numbers_equal_those_of_the_camera(counter):
    """At 30 Hz with 3 ms of jitter and one frame in six dropped."""
    rng = np.random.default_rng(8)
    there = rng.random(900) > 1 / 6
    there[:6] = True
    stamps = (np.arange(900) / 30 + rng.uniform(-1.5e-3, 1.5e-3, 900) + 5) * 1e9
    for number in np.flatnonzero(there) + 1:
        counter.step(int(stamps[number - 1]))
        assert counter.number == number
    assert counter.dropped == np.sum(~there[:number])
    assert counter.gaps == np.sum(there[1:] & ~there[:-1])


def test_repeated_and_late_stamps_are_left_out(counter):
    steps = [counter.step(t * MS) for t in (2000, 2100, 2100, 2200, 2150, 2400, 2500)]
    assert steps == [1, 1, 0, 1, 0, 2, 1]
    assert (counter.number, counter.repeated, counter.late) == (6, 1, 1)


def test_jump_back_restarts_numbers_but_a_late_stamp_does_not(counter):
    assert not counter.jumps_back(0)  # nothing has come yet
    for t in (2400, 2500):
        counter.step(t * MS)
    assert not counter.jumps_back(1500 * MS) and counter.jumps_back(1499 * MS)
    counter.step(2500 * MS)
    counter.restart()
    assert counter.number == 0 and not counter.jumps_back(0) and counter.step(0) == 1
    assert counter.repeated == 1  # the counts go on


def test_interval_follows_a_change_of_the_frame_rate(counter):
    """When 16 of the latest 31 intervals are new, the median is a new one."""
    for i in range(40):
        counter.step(i * 100 * MS)
    start = counter.last_ns
    steps = [counter.step(start + i * 50 * MS) for i in range(1, 17)]
    assert steps == [1] * 16
    assert counter.step(counter.last_ns + 100 * MS) == 2


def test_first_gap_sets_the_interval(counter):
    """One interval is its own median, so nothing is counted as dropped."""
    assert [counter.step(t * MS) for t in (0, 700, 1400)] == [1, 1, 1]
    assert counter.dropped == 0
