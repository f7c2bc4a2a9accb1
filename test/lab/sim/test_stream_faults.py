# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Faults in a stream: each has its effect, and only while it is active."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.records import StereoPair
from stereo_speed.lab.sim.stream_faults import FAULTS, FaultyStream
from stereo_speed.lab.sim.traffic import TrafficPair

START_NS, STEP_NS = 1_700_000_000_000_000_000, 100_000_000
COUNT = 200


def taken(fault, seed=0):
    """Return the pairs of a stream whose images show their exposure: left n, right 100 + n."""
    def stream():
        for n in range(COUNT):
            ns = START_NS + n * STEP_NS
            left, right = (np.full((4, 6), k, np.uint8) for k in (n % 100, 100 + n % 100))
            yield TrafficPair(StereoPair(n, ns, ns, left, right), ())
    return list(FaultyStream(stream(), fault, np.random.default_rng(seed)))


def is_sound(one):
    """Return whether a pair is unchanged."""
    n, pair = one.exposure, one.pair
    return (pair.stamp_ns == pair.right_stamp_ns == START_NS + n * STEP_NS
            and pair.left[0, 0] == n % 100 and pair.right[0, 0] == 100 + n % 100)


@pytest.mark.parametrize('fault', sorted(set(FAULTS) - {'none'}))
def test_fault_leaves_the_rest_of_the_stream_unchanged(fault):
    pairs = taken(fault)
    sound = [one for one in pairs if is_sound(one)]
    if fault.startswith(('right_', 'stamp_jitter')):  # these hold from the start
        assert len(pairs) >= COUNT - 1 and len(sound) < 0.01 * COUNT
    elif fault == 'twice':  # the second one is not newer
        assert len(sound) == COUNT
    else:
        assert 0.5 * COUNT < len(sound) < COUNT
    for before, after in zip(pairs, pairs[1:]):
        assert after.anew or after.pair.stamp_ns > before.pair.stamp_ns


def test_no_fault_changes_nothing():
    assert [is_sound(one) for one in taken('none')] == [True] * COUNT


@pytest.mark.parametrize(('fault', 'holds'), [
    ('black', lambda one: not one.pair.left.any() and not one.pair.right.any()),
    ('garbage_right', lambda one: np.ptp(one.pair.right) > 0 and np.ptp(one.pair.left) == 0),
    ('frozen_right', lambda one: one.pair.right[0, 0] < 100 + one.exposure % 100
     and one.pair.left[0, 0] == one.exposure % 100),
    ('swapped', lambda one: one.pair.left[0, 0] == one.pair.right[0, 0] + 100),
    ('right_20_ms', lambda one: one.pair.right_lag_s == pytest.approx(0.02)),
    ('clock_30_ms_on', lambda one: (one.pair.stamp_ns - START_NS) % STEP_NS == 30_000_000),
    ('clock_an_hour_back', lambda one: one.pair.stamp_ns < START_NS - 3500 * 10 ** 9),
])
def test_effect_of_each_fault(fault, holds):
    faulty = [one for one in taken(fault) if not is_sound(one)]
    # the first pair of a frozen view is unchanged
    assert len(faulty) > 5 and all(map(holds, faulty))


def test_time_restarts_when_it_jumps_back():
    pairs = taken('clock_an_hour_on')
    assert sum(one.anew for one in pairs) >= 2
    assert all(is_sound(one) for one in pairs if one.anew)
