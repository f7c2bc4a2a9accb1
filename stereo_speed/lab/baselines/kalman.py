# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``kalman``: a Kalman filter on the triangulated position of the front (2012, Section V-A).

State: position and velocity, with constant velocity and a random walk.  Measurement: the position
from triangulated SIFT points, with the covariance from the image Jacobian at half a pixel of
matching error (L. Matthies and S. A. Shafer 1987).  Velocities between pairs are not measured.
The path of the lane is not used.
"""
from __future__ import annotations

from .point_tracker import PointTracker
from .settings import SiftSettings
from .sift import SiftPoints


class KalmanTracker(PointTracker[SiftSettings]):
    """Filter the positions of triangulated SIFT points, and smooth the whole pass backwards."""

    Settings = SiftSettings

    def _source(self) -> SiftPoints:
        return SiftPoints(self.rig, self.settings)
