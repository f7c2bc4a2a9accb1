# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Virtual parallel cameras and their disparities."""
from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_speed.lab.baselines.rectify import Rectifier
from stereo_speed.lab.sim.config import DISTORTED, straight_config
from stereo_speed.lab.sim.scene import SimScene


@pytest.fixture(scope='module')
def rig():
    """Converging cameras with lens distortion."""
    return SimScene(straight_config(rig=DISTORTED)).rig


def test_points_are_on_one_row_at_their_disparity(rig):
    virtual = Rectifier(rig)
    points = np.random.default_rng(0).uniform([-3, -2, 15], [3, 2, 60], (20, 3))
    left, disparity = virtual.project(points, points)
    centre = -rig.R.T @ rig.t
    seen = (points - centre) @ virtual.rotation.T  # from the right camera, rotated alike
    right = virtual.f_px * seen[:, :2] / seen[:, 2:]
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-9)
    np.testing.assert_allclose(left[:, 0] - right[:, 0], disparity, atol=1e-9)
    np.testing.assert_allclose(disparity, virtual.f_px * rig.baseline_m
                               / (points @ virtual.rotation.T)[:, 2])


def test_points_behind_the_cameras_have_no_disparity(rig):
    behind = np.array([[0.0, 0.0, -5.0]])
    uv, disparity = Rectifier(rig).project(behind, behind)
    assert np.isnan(uv).all() and np.isnan(disparity).all()


def test_warped_point_is_where_its_3d_point_projects(rig):
    virtual, point = Rectifier(rig), np.array([[0.4, 0.3, 25.0]])
    uv, disparity = virtual.project(point, point)
    low = np.round(uv[0]) - 20
    for right, shift in ((False, 0.0), (True, float(disparity[0]))):
        raw = np.zeros((768, 1024), np.uint8)
        u, v = rig.project(point)[int(right)][0]
        cv2.circle(raw, (round(u * 16), round(v * 16)), 3 * 16, 255, -1, cv2.LINE_AA, 4)
        start = low - [round(shift), 0]
        found = virtual.region(raw, right, start, (41, 41)).astype(float)
        centre = [(found * axis).sum() / found.sum()
                  for axis in (np.arange(41), np.arange(41)[:, None])]
        np.testing.assert_allclose(centre + start, uv[0] - [shift, 0], atol=0.1)


@pytest.mark.parametrize('shift', [-9, 12, 33])
def test_disparity_of_a_moved_texture(parallel, shift):
    virtual = Rectifier(parallel)
    rng = np.random.default_rng(0)
    left = cv2.GaussianBlur(rng.integers(0, 256, (768, 1024)).astype(np.uint8), (0, 0), 1.5)
    right = np.roll(left, -shift, axis=1)
    # The virtual cameras are the real ones, with the origin at the principal point.
    found = virtual.disparity(left, right, np.array([-40.0, -20]), np.array([40.0, 20]),
                              (shift - 8.0, shift + 8.0))
    assert found.shape == (40, 80) and np.isfinite(found).mean() > 0.9
    assert np.nanmedian(found) == pytest.approx(shift, abs=0.1)
