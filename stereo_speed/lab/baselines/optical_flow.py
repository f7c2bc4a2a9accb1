# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``flow``: what one would wire today from the shelf, optical flow with stereo depth.

Corners of the front are followed by pyramidal Lucas-Kanade over time and matched by the same to
the right view, to a fraction of a pixel (``lucas_kanade``); triangulated, robustly located and
Kalman-filtered like ``kalman``.  CSRT and its kin are in OpenCV's contrib modules only, and give
boxes of whole pixels.  The path of the lane is not used.
"""
from __future__ import annotations

from .lucas_kanade import FlowPoints
from .point_tracker import PointTracker
from .settings import FlowSettings


class FlowTracker(PointTracker[FlowSettings]):
    """Filter the positions of points followed by optical flow in both views."""

    Settings = FlowSettings

    def _source(self) -> FlowPoints:
        return FlowPoints(self.rig, self.settings)
