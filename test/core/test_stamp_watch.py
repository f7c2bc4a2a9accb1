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


def unevenness_s(stamps_ns, most_s=4e-4):
    watch = StampWatch()
    for ns in map(int, stamps_ns):
        watch.add(ns)
    return watch.unevenness_s(most_s)


@pytest.mark.parametrize('period_ns', [PERIOD_NS, 33_366_700])
def test_how_uneven_stamps_are_is_found_but_for_what_twenty_intervals_leave_open(period_ns):
    """With images missing, too; the mean over many streams is right to a few percent."""
    rng, std_ns = np.random.default_rng(2), 1.5e6
    found = []
    for _ in range(300):
        kept = np.flatnonzero(rng.random(60) > 0.2)
        found.append(unevenness_s(period_ns * kept + rng.normal(0, std_ns, len(kept))))
    assert None not in found
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(std_ns * 1e-9, rel=0.1)


def test_the_first_intervals_leave_more_open():
    """Whose 1-sigma is taken for the truth is too sure: the mean error over it is 1 or less."""
    rng, ratios = np.random.default_rng(3), []
    for _ in range(2000):
        found = unevenness_s(PERIOD_NS * np.arange(6) + rng.normal(0, 3e6, 6), 0.0)
        if found is not None:
            ratios.append(3e-3 / found)
    assert len(ratios) > 1990 and np.sqrt(np.mean(np.square(ratios))) < 1.1


@pytest.mark.parametrize('stamps_ns', [
    PERIOD_NS * np.arange(5.0),  # too few to tell
    PERIOD_NS * np.delete(np.arange(60), [30, 31, 45, 52, 53]),
    PERIOD_NS * np.arange(60) + np.random.default_rng(0).normal(0, 2e5, 60),  # as it should be
    np.cumsum(np.random.default_rng(1).uniform(1e8, 3e8, 60)),  # no pace
    PERIOD_NS * np.arange(60) + 30_000_000 * (np.arange(60) > 50)])  # a step
def test_of_even_stamps_missing_images_steps_and_of_no_pace_nothing_is_said(stamps_ns):
    assert unevenness_s(stamps_ns) is None


def test_stamps_good_to_their_parameter_are_hardly_ever_told_to_be_worse():
    rng = np.random.default_rng(4)
    told = [unevenness_s(PERIOD_NS * np.arange(count) + rng.normal(0, 2e5, count)) is not None
            for count in rng.integers(6, 30, 2000)]
    assert np.mean(told) < 0.002
