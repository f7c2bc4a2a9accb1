# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Steps of the clock are told from missing images, from jitter and from uneven exposures."""
import numpy as np
import pytest
from stereo_speed.core.stamp_watch import StampWatch

PERIOD_NS = 200_000_000


def steps_s(stamps_ns):
    watch = StampWatch()
    return [step for step in map(watch.add, map(int, stamps_ns)) if step]


@pytest.mark.parametrize('step_ns', [30_000_000, -30_000_000, 5_000_000])
def test_a_step_is_found_once(step_ns):
    stamps = PERIOD_NS * np.arange(60)
    stamps[40:] += step_ns
    assert steps_s(stamps) == pytest.approx([step_ns * 1e-9])


def test_missing_images_are_no_step():
    assert steps_s(PERIOD_NS * np.delete(np.arange(80), [30, 31, 45, 60, 61, 62])) == []


def test_small_jitter_is_no_step():
    jitter = np.random.default_rng(0).normal(0, 1e5, 200)
    assert steps_s(PERIOD_NS * np.arange(200) + jitter) == []


def test_of_uneven_exposures_nothing_is_said():
    assert steps_s(np.cumsum(np.random.default_rng(1).uniform(1e8, 3e8, 200))) == []


def test_another_frame_rate_is_a_new_pace():
    stamps = np.cumsum([PERIOD_NS] * 40 + [PERIOD_NS // 3] * 80)
    assert len(steps_s(stamps)) <= 20  # until it has the new pace
    assert steps_s(stamps[60:]) == []
