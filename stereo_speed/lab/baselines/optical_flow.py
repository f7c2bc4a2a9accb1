# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``flow``: what one would build today from standard parts, optical flow with stereo depth.

Corners of the front are tracked by pyramidal Lucas-Kanade over time and matched in the same way to
the right view, with sub-pixel precision (``lucas_kanade``); they are triangulated, robustly
averaged and Kalman-filtered like ``kalman``.  CSRT and similar trackers are only in OpenCV's
contrib modules, and give boxes in whole pixels.  The path of the lane is not used.
"""
from __future__ import annotations

from .lucas_kanade import FlowPoints
from .point_tracker import PointTracker
from .settings import FlowSettings


class FlowTracker(PointTracker[FlowSettings]):
    """Filter the positions of points tracked by optical flow in both views."""

    Settings = FlowSettings

    def _source(self) -> FlowPoints:
        return FlowPoints(self.rig, self.settings)
