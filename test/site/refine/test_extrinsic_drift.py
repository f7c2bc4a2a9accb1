# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Whether a camera has turned: decisions, and honest uncertainty over many rigs."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.site.refine.extrinsic_drift import (
    CALIBRATED_STD_DEG, judged, MOVED_PROBABILITY, MOVED_STD_DEG)

STD_DEG = np.array([0.0008, 0.0003, 0.002])


def test_nothing_moved():
    turn = judged(np.radians([0.0005, -0.0002, 0.001]), np.diag(np.radians(STD_DEG)**2))
    assert not turn.moved and turn.moved_probability < 0.05
    left = np.degrees(np.sqrt(np.diag(turn.covariance_rad2)))
    assert np.all(left < 3 * CALIBRATED_STD_DEG) and np.all(left > 0.5 * CALIBRATED_STD_DEG)


@pytest.mark.parametrize('axis', [0, 1, 2], ids=['pan', 'tilt', 'roll'])
def test_one_angle_moved(axis):
    shown = np.zeros(3)
    shown[axis] = 0.02
    turn = judged(np.radians(shown), np.diag(np.radians(STD_DEG)**2))
    assert turn.moved and turn.moved_probability > 0.99
    assert np.degrees(turn.turn_rad[axis]) == pytest.approx(0.02, rel=0.02)
    assert np.count_nonzero(turn.turn_rad) == 1
    assert np.degrees(np.sqrt(turn.covariance_rad2[axis, axis])) == pytest.approx(
        STD_DEG[axis], rel=0.1)


def test_what_cannot_be_seen_stays_uncertain():
    """An angle that the images do not show may have moved as often as any."""
    turn = judged(np.zeros(3), np.diag(np.radians([5.0, 0.0003, 0.002])**2))
    expected = np.sqrt(MOVED_PROBABILITY * MOVED_STD_DEG**2)
    assert np.degrees(np.sqrt(turn.covariance_rad2[0, 0])) == pytest.approx(expected, rel=0.05)


def test_uncertainty_covers_the_decision():
    """Over rigs drawn from the same belief the error has the claimed second moment."""
    rng = np.random.default_rng(0)
    covariance = np.diag(np.radians(STD_DEG)**2)
    scores, variances, squares = [], [], []
    for _ in range(3000):
        moved = rng.random(3) < MOVED_PROBABILITY
        truth = np.radians(np.where(moved, MOVED_STD_DEG, CALIBRATED_STD_DEG)
                           * rng.standard_normal(3))
        turn = judged(truth + np.radians(STD_DEG) * rng.standard_normal(3), covariance)
        off = turn.turn_rad - truth
        squares.append(off**2)
        variances.append(np.diag(turn.covariance_rad2))
        scores.append(off**2 / np.diag(turn.covariance_rad2))
    assert np.all(np.abs(np.mean(scores, axis=0) - 1) < 0.25)
    ratio = np.mean(squares, axis=0) / np.mean(variances, axis=0)
    assert np.all((ratio > 0.75) & (ratio < 1.3))
