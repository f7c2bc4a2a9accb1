# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``triangulation``: speed from the motion of triangulated points (2012, Section V-A).

SIFT points are matched left to right and over time and triangulated optimally (Hartley and Sturm
1997).  The paper takes the displacement of the centroid of all points between pairs as velocity.
Here it is the robust mean displacement of the points seen in both pairs, weighted by their
covariances, or that of the front's centre on its plane, whichever is more certain, because a bare
centroid jumps when points appear or disappear.  Nothing is filtered over time; a Kalman filter
only predicts where to search next.  The speeds of the whole pass are those of a smooth curve
through the positions.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .baseline import Estimate
from .front_position import displacement, Measurement
from .point_tracker import PointTracker
from .settings import SiftSettings
from .sift import SiftPoints
from .speed_profile import fitted_profile, Profile
from ...core.records import Array, StereoPair
from ...tracking.initialise import Placement
from ...tracking.protocol import TrackStart


class TriangulationTracker(PointTracker[SiftSettings]):
    """Report the motion of triangulated SIFT points from pair to pair."""

    Settings = SiftSettings

    def __init__(self, start: TrackStart, placed: Placement, settings: SiftSettings) -> None:
        super().__init__(start, placed, settings)
        self.velocity = self.belief.mean[3:]
        self.velocity_cov = start.expected_std_mps ** 2 * np.eye(3)
        self.points_m: dict[int, Array] = {}
        self.positions: list[Measurement] = []

    def _source(self) -> SiftPoints:
        return SiftPoints(self.rig, self.settings)

    def _use_points(self, ids: NDArray[np.int64], xyz: Array, position: Measurement,
                    pair: StereoPair) -> None:
        """Measure the velocity since the last pair with an observation."""
        if self.positions:
            dt_s = (pair.stamp_ns - self.life.stamps_ns[-1]) * 1e-9
            before = self.positions[-1]
            motions = [Measurement(position.mean - before.mean, position.cov + before.cov,
                                   position.used)]
            known = np.array([int(i) in self.points_m for i in ids], dtype=bool)
            if known.any():
                old = np.array([self.points_m[int(i)] for i in ids[known]])
                same = displacement(self.rig, old, xyz[known], self.axes[:, 0], self.settings)
                motions += [] if same is None else [same]
            motion = min(motions, key=lambda m: float(np.trace(m.cov)))
            self.velocity, self.velocity_cov = motion.mean / dt_s, motion.cov / dt_s ** 2
        self.points_m = {int(i): x for i, x in zip(ids, xyz)}
        self.positions.append(position)

    def _estimate(self) -> Estimate:
        own = replace(super()._estimate(), velocity_mps=self.velocity,
                      velocity_cov=self.velocity_cov)
        if not self.seen or not self.seen[-1]:
            return own
        position = self.positions[-1]
        return replace(own, position_m=position.mean, position_cov=position.cov)

    def _profile(self) -> Profile:
        times = (np.array(self.life.stamps_ns) - self.life.stamps_ns[0]) * 1e-9
        return fitted_profile(times, np.array([p.mean for p in self.positions]),
                              np.array([p.cov for p in self.positions]))
