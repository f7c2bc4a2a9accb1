# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The effect of extrinsic drift on lengths, against closed forms."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.road.lanes import lane_of_paths, LanePath
from stereo_speed.road.path import StraightPath
from stereo_speed.road.scale import pass_scale_by_drift, scale_by_drift, with_scale


def make_rig(baseline_m=0.5):
    """Return a parallel rig."""
    k = np.array([[1800.0, 0.0, 511.5], [0.0, 1800.0, 383.5], [0.0, 0.0, 1.0]])
    cameras = [Camera(n, 1024, 768, k, np.zeros(0), 'plumb_bob') for n in ('left', 'right')]
    return StereoRig(*cameras, np.eye(3), np.array([-baseline_m, 0.0, 0.0]))


PATH = StraightPath(np.array([-3.0, 3.0, 70.0]), np.array([0.0, 0.0, -1.0]), 50.0)


def test_pan_along_the_line_of_sight():
    """Disparity d + f pan: Z' = f b / (d + f pan), so dZ'/dZ = 1 - 2 Z pan / b."""
    s = np.array([5.0, 25.0, 45.0])
    z = PATH.position(s)[:, 2]
    slope = scale_by_drift(PATH, make_rig(), s)[:, 0]
    assert np.all(np.abs(np.abs(slope) / (2 * z / 0.5) - 1) < 0.02)
    assert len(set(np.sign(slope))) == 1


def test_scale_of_a_lane():
    """At each place 2 Z pan / b; over the pass between its ends, closer to the near one."""
    pan = np.radians(0.001)
    bare = LanePath('lane', PATH, None, np.zeros(2), 0.0)
    lane = with_scale(bare, make_rig(), np.diag([pan**2, 0.0, 0.0]))
    np.testing.assert_allclose(lane.scale_std_at(np.array([1.0, 49.0])),
                               4 * pan * np.array([69.0, 21.0]), rtol=0.05)
    assert 4 * pan * 20 < lane.scale_std < 4 * pan * 45
    twice = with_scale(bare, make_rig(), np.diag([4 * pan**2, 0.0, 0.0]))
    assert twice.scale_std == pytest.approx(2 * lane.scale_std)


@pytest.mark.parametrize('length_m', [100.0, 800.0, 1500.0])
def test_scale_of_a_line_that_goes_on_beyond_the_view(length_m):
    """A road that crosses the view 20 m away, surveyed over any length."""
    def lane_of(length_m):
        ahead = np.array([1.0, 0.0, 0.02])
        path = StraightPath(np.array([0.0, 3.0, 20.0]) - ahead * length_m / 2, ahead, length_m)
        return with_scale(LanePath('lane', path, None, np.zeros(2), 0.0), make_rig(),
                          np.diag([np.radians(0.001)**2, 0.0, 0.0]))
    short, long = lane_of(12.0), lane_of(length_m)
    assert long.scale_std == pytest.approx(short.scale_std, rel=0.05)
    std = lane_of_paths('lane', (long.path,), None, make_rig(), 0.03).shape_std
    assert std > 0 and std * (length_m / 12.0)**2 == pytest.approx(lane_of_paths(
        'lane', (short.path,), None, make_rig(), 0.03).shape_std, rel=0.5)


def test_scale_of_a_line_of_which_little_is_in_view():
    """Three metres of a road that crosses the view 8 m away."""
    def std(length_m):
        path = StraightPath(np.array([-length_m / 2, 1.0, 8.0]), np.array([1.0, 0.0, 0.02]),
                            length_m)
        return with_scale(LanePath('lane', path, None, np.zeros(2), 0.0), make_rig(),
                          np.diag([np.radians(0.001)**2, 0.0, 0.0])).scale_std
    assert std(25.0) == pytest.approx(std(6.0), rel=0.3) and std(25.0) > 0


def test_path_out_of_view_keeps_its_scale():
    behind = StraightPath(np.array([0.0, 3.0, -70.0]), np.array([0.0, 0.0, -1.0]), 50.0)
    lane = LanePath('lane', behind, None, np.zeros(2), 0.0)
    assert with_scale(lane, make_rig(), np.eye(3)) is lane
    assert np.isnan(scale_by_drift(behind, make_rig(), np.array([1.0]))).all()
    assert np.isnan(pass_scale_by_drift(behind, make_rig())).all()


def test_pan_and_roll_change_speeds_with_their_signs():
    """
    Compare with the ray of the right camera at 40 m, 2 m below its axis.

    A pan to the right reduces the disparity b / Z by the angle: Z' = Z + Z^2 pan / b.  A clockwise
    roll increases it by Y / Z times the angle: Z' = Z / (1 + Y roll / b).
    """
    path = StraightPath(np.array([0.25, 2.0, 40.5]), np.array([0.0, 0.0, -1.0]), 1.0)
    slope = pass_scale_by_drift(path, make_rig(0.5))
    assert slope[0] == pytest.approx(2 * 40 / 0.5, rel=0.02)
    assert slope[2] == pytest.approx(-2 / 0.5, rel=0.02)
