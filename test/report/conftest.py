# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A small scene to draw: a parallel rig, a straight lane, one vehicle's pass."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.core.passes import PassResult, Verdict
from stereo_speed.core.records import StereoPair, TrackState, TrackUpdate
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.road.path import StraightPath

STEP_NS = 200_000_000
SPEED_MPS = 20.0


@pytest.fixture(scope='session')
def rig() -> StereoRig:
    K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])

    def camera(name: str) -> Camera:
        return Camera(name=name, width_px=640, height_px=480, K=K, D=np.zeros(5),
                      model='plumb_bob')
    return StereoRig(left=camera('left'), right=camera('right'), R=np.eye(3),
                     t=np.array([-0.5, 0.0, 0.0]), frame_id='left')


@pytest.fixture(scope='session')
def lanes() -> dict:
    path = StraightPath([0.0, 2.0, 60.0], [0.0, 0.0, -1.0], 80.0)  # continues behind the camera
    return {'near': SimpleNamespace(name='near', path=path, speed_limit_mps=22.352)}


def quad_px(camera: Camera, centre: np.ndarray) -> np.ndarray:
    """Project a front of 1.8 m by 0.8 m around a point in the camera's frame."""
    corners = np.array([[-0.9, -0.4, 0], [0.9, -0.4, 0], [0.9, 0.4, 0], [-0.9, 0.4, 0]])
    return camera.project(corners + centre)[0]


@pytest.fixture(scope='session')
def updates(rig) -> list[TrackUpdate]:
    def at(k: int) -> TrackUpdate:
        centre = np.array([0.0, 1.0, 50.0 - SPEED_MPS * k * STEP_NS * 1e-9])
        return TrackUpdate(
            stamp_ns=1_000 + k * STEP_NS, track=3, lane='near',
            state=TrackState.TENTATIVE if k < 2 else TrackState.CONFIRMED,
            speed_mps=SPEED_MPS, speed_std_mps=0.3, s_m=60.0 - centre[2], lateral_m=0.0,
            position_m=centre, position_cov_m2=np.eye(3) * 0.01, axes=np.eye(3),
            quad_left_px=quad_px(rig.left, centre),
            quad_right_px=quad_px(rig.right, centre + rig.t))
    return [at(k) for k in range(8)]


@pytest.fixture(scope='session')
def passes(updates) -> list[PassResult]:
    stamps = [u.stamp_ns for u in updates]
    return [PassResult(
        track=3, lane='near', first_ns=stamps[0], last_ns=stamps[-1], pairs=len(stamps),
        speed_mps=SPEED_MPS, speed_std_mps=0.1, verdict=Verdict.MEASURED, reason='',
        smoothed=dict.fromkeys(stamps, SPEED_MPS), smoothed_std=dict.fromkeys(stamps, 0.2))]


@pytest.fixture
def pair(updates) -> StereoPair:
    image = np.full((480, 640), 90, np.uint8)
    stamp = updates[4].stamp_ns
    return StereoPair(index=4, stamp_ns=stamp, right_stamp_ns=stamp, left=image, right=image)
