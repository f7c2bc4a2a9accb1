# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Images transformed to a rig at rest."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.core.records import RigMotion, StereoPair
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.geometry.steadied import moved_px, steadied

K = np.array([[700.0, 0.0, 199.5], [0.0, 700.0, 149.5], [0.0, 0.0, 1.0]])
MOTION = RigMotion((2e-3, -1e-3, 3e-3), (5e-4, 3e-4, -2e-4))


@pytest.fixture
def rig():
    """Return two cameras with distortion."""
    cameras = [Camera(name, 400, 300, K, np.array([-0.2, 0.1, 1e-3, -1e-3]), 'plumb_bob')
               for name in ('left', 'right')]
    return StereoRig(*cameras, cv2.Rodrigues(np.array([0.01, -0.03, 0.005]))[0],
                     np.array([-0.5, 0.01, 0.02]))


@pytest.mark.parametrize('right', [False, True])
def test_pixels_of_distant_points_move_like_the_points(rig, right):
    points = np.random.default_rng(0).uniform([-2e5, -1e5, 1e6], [2e5, 1e5, 2e6], (20, 3))
    before, after = (r.project(points)[int(right)] for r in (rig, rig.as_taken(MOTION)))
    np.testing.assert_allclose(moved_px(rig, rig.as_taken(MOTION), right, before), after,
                               atol=1e-3)


def test_steadied_pair_equals_the_pair_before_the_motion(rig):
    def drawn(now, right):
        v, u = np.mgrid[:300, :400].astype(float)
        camera, R = (now.right, now.R) if right else (now.left, np.eye(3))
        x, y, z = np.moveaxis(camera.rays(np.stack([u, v], axis=-1)) @ R, -1, 0)
        return 120 + 60 * np.sin(150 * x / z) * np.cos(110 * y / z)
    before, after = ([np.rint(drawn(r, side)).astype(np.uint8) for side in (False, True)]
                     for r in (rig, rig.as_taken(MOTION)))
    pair = steadied(StereoPair(0, 0, 0, *after, motion=MOTION), rig)
    assert pair.motion is None
    inner = slice(8, -8), slice(8, -8)
    for image, wanted, moved in zip((pair.left, pair.right), before, after):
        off = image[inner].astype(float) - wanted[inner]
        assert np.sqrt(np.mean(off ** 2)) < 0.8  # whole grey levels, twice
        assert np.sqrt(np.mean((moved[inner].astype(float) - wanted[inner]) ** 2)) > 5


def test_unmoved_pair_is_unchanged(rig):
    pair = StereoPair(0, 0, 0, np.zeros((300, 400), np.uint8), np.zeros((300, 400), np.uint8))
    assert steadied(pair, rig) is pair
