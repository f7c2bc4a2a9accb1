# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``kalman``: a Kalman filter on the triangulated place of the front (2012, Section V-A).

State: place and velocity, constant velocity with a random walk.  Measurement: the place from
triangulated SIFT points, its covariance by the image Jacobian at half a pixel of matching error
(L. Matthies and S. A. Shafer 1987).  Velocities between pairs are not measured.  The path of the
lane is not used.
"""
from __future__ import annotations

from .point_tracker import PointTracker
from .points import PointSource
from .sift import SiftPoints


class KalmanTracker(PointTracker):
    """Filter the places of triangulated SIFT points; smoothed backwards for the whole pass."""

    def _source(self) -> tuple[PointSource, float]:
        return SiftPoints(self.rig), self.settings.feature_std_px
