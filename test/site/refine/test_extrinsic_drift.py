# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Rotation of a camera: decisions, and consistent uncertainty over many rigs."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.road.problem import RoadPrior
from stereo_speed.site.refine.config import RefineConfig
from stereo_speed.site.refine.extrinsic_drift import decide_drift, FamilyDrift

CONFIG, CALIBRATED_DEG = RefineConfig(), RoadPrior().calibrated_std_deg
STD_DEG = np.array([0.0008, 0.0003, 0.002])


def test_nothing_moved():
    drift = decide_drift([FamilyDrift(0.0, np.radians([0.0005, -0.0002, 0.001]),
                                      np.diag(np.radians(STD_DEG)**2))])
    assert not drift.moved and drift.moved_probability < 0.05
    left = np.degrees(drift.std_rad)
    assert np.all(left < 3 * CALIBRATED_DEG) and np.all(left > 0.5 * CALIBRATED_DEG)


@pytest.mark.parametrize('axis', [0, 1, 2], ids=['pan', 'tilt', 'roll'])
def test_one_angle_moved(axis):
    shown = np.zeros(3)
    shown[axis] = 0.02
    drift = decide_drift([FamilyDrift(0.0, np.radians(shown), np.diag(np.radians(STD_DEG)**2))])
    assert drift.moved and drift.moved_probability > 0.99
    assert np.degrees(drift.drift_rad[axis]) == pytest.approx(0.02, rel=0.02)
    assert np.count_nonzero(drift.drift_rad) == 1
    assert np.degrees(np.sqrt(drift.covariance_rad2[axis, axis])) == pytest.approx(
        STD_DEG[axis], rel=0.1)


def test_unobservable_angle_stays_uncertain():
    """An angle that the images do not show keeps its prior probability of having moved."""
    drift = decide_drift([FamilyDrift(
        0.0, np.zeros(3), np.diag(np.radians([5.0, 0.0003, 0.002])**2))])
    expected = np.sqrt(CONFIG.moved_probability * CONFIG.moved_std_deg**2)
    assert np.degrees(np.sqrt(drift.covariance_rad2[0, 0])) == pytest.approx(expected, rel=0.05)


@pytest.mark.slow
def test_uncertainty_includes_that_of_the_decision():
    """Over rigs drawn from the same prior the error has the claimed second moment."""
    rng = np.random.default_rng(0)
    covariance = np.diag(np.radians(STD_DEG)**2)
    scores, variances, squares = [], [], []
    for _ in range(2000):
        moved = rng.random(3) < CONFIG.moved_probability
        truth = np.radians(np.where(moved, CONFIG.moved_std_deg, CALIBRATED_DEG)
                           * rng.standard_normal(3))
        drift = decide_drift([FamilyDrift(
            0.0, truth + np.radians(STD_DEG) * rng.standard_normal(3), covariance)])
        off = drift.drift_rad - truth
        squares.append(off**2)
        variances.append(np.diag(drift.covariance_rad2))
        scores.append(off**2 / np.diag(drift.covariance_rad2))
    assert np.all(np.abs(np.mean(scores, axis=0) - 1) < 0.25)
    ratio = np.mean(squares, axis=0) / np.mean(variances, axis=0)
    assert np.all((ratio > 0.75) & (ratio < 1.3))


def test_equally_good_road_without_a_pan_prevents_a_correction():
    """One family finds a pan of 30 sigmas; another, more likely by e^10, finds none."""
    small = np.diag(np.radians([0.001, 0.0003, 0.002])**2)
    plane = FamilyDrift(0.0, np.radians([0.03, 0.0, 0.0]), small)
    assert decide_drift([plane]).moved
    crest = FamilyDrift(10.0, np.zeros(3), small)
    drift = decide_drift([plane, crest])
    assert not drift.moved and drift.moved_probability < 0.02
    # if both are equally likely, the uncorrected angle is uncertain
    drift = decide_drift([plane, crest._replace(log_evidence=-6.0)])
    assert np.degrees(drift.std_rad[0]) > 0.005
