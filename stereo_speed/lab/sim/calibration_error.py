# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Draw what a calibration may have got wrong."""
from __future__ import annotations

from dataclasses import replace
from typing import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ...core.records import Array
from ...core.tracker_config import TrackerConfig
from ...geometry.camera import Camera
from ...geometry.rig import StereoRig
from ...road.problem import RoadPrior

_ACROSS = 15  # places across an image at which two views are compared


def drawn_calibration(rig: StereoRig, tolerances: TrackerConfig, rng: np.random.Generator
                      ) -> StereoRig:
    """
    Return a calibration of a rig with normal errors that have the tolerances as 1-sigma.

    Both focal lengths have the same relative error, as from one calibration, which makes the views
    agree at infinity: with converging cameras an error of the focal length also displaces one view
    against the other, unless the angles between them make up for it.

    :param rig: the true rig.
    :param tolerances: has the 1-sigmas ``focal_std`` and ``baseline_std_m``; the errors of the
        angles between the cameras have the 1-sigma of a calibrated rig.
    """
    angles = np.radians(RoadPrior().calibrated_std_deg) * rng.standard_normal(3)
    rig = rig.drifted(angles)
    focal = 1 + tolerances.focal_std * rng.standard_normal()
    baseline = 1 + tolerances.baseline_std_m / rig.baseline_m * rng.standard_normal()
    left, right = (replace(camera, K=camera.K * [[focal, focal, 1], [focal, focal, 1], [1, 1, 1]])
                   for camera in (rig.left, rig.right))
    R = _agreeing_at_infinity(rig, (left, right))
    return StereoRig(left, right, R, R @ rig.R.T @ rig.t * baseline)


def _agreeing_at_infinity(rig: StereoRig, cameras: Sequence[Camera]) -> Array:
    """
    Return the rotation (3, 3) with which other cameras see infinity as a rig does.

    :param rig: the rig.
    :param cameras: left and right camera to use instead of its own.
    """
    u, v = np.meshgrid(*(np.linspace(0.0, size - 1.0, _ACROSS)
                         for size in (rig.left.width_px, rig.left.height_px)))
    left_px = np.column_stack([u.ravel(), v.ravel()])
    right_px, seen = rig.right.project(rig.left.rays(left_px) @ rig.R.T)
    rays = [each.rays(uv) for each, uv in zip(cameras, (left_px, right_px))]
    seen &= np.isfinite(np.hstack(rays)).all(axis=1)
    left, right = (ray[seen] / np.linalg.norm(ray[seen], axis=1, keepdims=True) for ray in rays)
    return np.asarray(Rotation.align_vectors(right, left)[0].as_matrix())
