# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Speeds measured along wrong paths and with wrong rigs, against closed forms."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import SplinePath, StraightPath
from stereo_speed.road.scale import with_scale
from stereo_speed.site.refine.speed_effect import heading_effect, Setup, speed_error


def make_rig(baseline_m=0.5):
    """Return a parallel rig."""
    k = np.array([[1800.0, 0.0, 511.5], [0.0, 1800.0, 383.5], [0.0, 0.0, 1.0]])
    cameras = [Camera(n, 1024, 768, k, np.zeros(0), 'plumb_bob') for n in ('left', 'right')]
    return StereoRig(*cameras, np.eye(3), np.array([-baseline_m, 0.0, 0.0]))


PATH = StraightPath(np.array([-3.0, 3.0, 70.0]), np.array([0.0, 0.0, -1.0]), 50.0)


def test_no_error_has_no_effect():
    assert abs(speed_error(Setup(PATH, make_rig()), Setup(PATH, make_rig()))) < 1e-9


def test_errors_of_baseline_and_path_in_proportion():
    """Rig and path a thousandth too large: speeds a thousandth too high."""
    large = StraightPath(PATH.position(0.0) * 1.001, PATH.tangent(0.0), 50.05)
    used = Setup(large, make_rig(0.5005))
    assert speed_error(Setup(PATH, make_rig()), used) == pytest.approx(1e-3, rel=1e-3)


def test_drifted_rig_and_the_path_seen_with_it():
    """The effect of a pan on a speed is that of the distorted space at the weighted range."""
    rig, pan = make_rig(), np.radians(0.01)
    drifted = rig.drifted([pan, 0.0, 0.0])
    points = rig.project(PATH.position(np.linspace(0, 50, 11)))
    seen = SplinePath(drifted.triangulate(points[0], points[1]))
    error = speed_error(Setup(PATH, rig), Setup(seen, drifted))
    lane = LanePath('lane', PATH, None, np.zeros(2), 0.0)
    lane = with_scale(lane, rig, np.diag([pan**2, 0.0, 0.0]))
    assert abs(error) == pytest.approx(lane.scale_std, rel=0.05) and abs(error) > 0.01
    # 2 Z pan / b at the far and the near end
    np.testing.assert_allclose(lane.scale_std_at(np.array([1.0, 49.0])),
                               4 * pan * np.array([69.0, 21.0]), rtol=0.05)


def test_effect_of_direction_is_in_proportion():
    one = heading_effect(PATH, make_rig(), np.array([1e-4, 1e-4]))
    ten = heading_effect(PATH, make_rig(), np.array([1e-3, 1e-3]))
    assert 0 < one < 1e-3 and ten == pytest.approx(10 * one, rel=0.1)


@pytest.mark.parametrize(('length_m', 'known'), [(400.0, False), (10.0, True)])
def test_a_path_of_which_only_its_end_is_seen_has_no_speed(length_m, known):
    """The path ends 12 m ahead; of 400 m from behind the cameras, 3 of 101 samples are seen."""
    path = StraightPath(np.array([0.0, 1.0, 12.0 - length_m]), np.array([0.0, 0.0, 1.0]), length_m)
    setup = Setup(path, make_rig())
    assert np.isfinite(speed_error(setup, setup)) == known
