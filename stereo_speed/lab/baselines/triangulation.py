# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``triangulation``: speed from the motion of triangulated points (2012, Section V-A).

SIFT points are matched left to right and over time and triangulated optimally (Hartley and Sturm
1997).  The paper takes the displacement of the centroid of all points between pairs for the
velocity.  Here it is the mean displacement of the points seen in both pairs, robust and weighted
by their covariances, or that of the front's centre on its plane, whichever is known better: a
bare centroid jumps with the points that come and go.  Nothing is filtered over time; a Kalman
filter only tells where to look next.  The speeds of the whole pass are those of a smooth curve
through the places.
"""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .common import Reading
from .places import displacement, Place
from .point_tracker import PointTracker
from .points import PointSource
from .settings import BaselineSettings
from .sift import SiftPoints
from .speed_profile import fitted_profile, Profile
from ...core.records import Array, StereoPair
from ...tracking.initialise import Placement
from ...tracking.protocol import TrackStart


class TriangulationTracker(PointTracker):
    """Report the motion of triangulated SIFT points from pair to pair."""

    def __init__(self, start: TrackStart, placed: Placement, settings: BaselineSettings) -> None:
        super().__init__(start, placed, settings)
        velocity, std = self._first_velocity()
        self.velocity, self.velocity_cov = velocity, std ** 2 * np.eye(3)
        self.cloud: dict[int, Array] = {}
        self.places: list[Place] = []
        self.at_ns: list[int] = []

    def _source(self) -> tuple[PointSource, float]:
        return SiftPoints(self.rig), self.settings.feature_std_px

    def _take_in(self, ids: NDArray[np.int64], xyz: Array, place: Place,
                 pair: StereoPair) -> None:
        """Measure the velocity since the last pair it was seen in."""
        if self.at_ns:
            dt_s = (pair.stamp_ns - self.at_ns[-1]) * 1e-9
            before = self.places[-1]
            ways = [Place(place.mean - before.mean, place.cov + before.cov, place.used)]
            again = np.array([int(i) in self.cloud for i in ids], dtype=bool)
            if again.any():
                old = np.array([self.cloud[int(i)] for i in ids[again]])
                same = displacement(self.rig, old, xyz[again], self.axes[:, 0], self.std_px)
                ways += [] if same is None else [same]
            way = min(ways, key=lambda w: float(np.trace(w.cov)))
            self.velocity, self.velocity_cov = way.mean / dt_s, way.cov / dt_s ** 2
        self.cloud = {int(i): x for i, x in zip(ids, xyz)}
        self.places.append(place)
        self.at_ns.append(pair.stamp_ns)

    def _reading(self) -> Reading:
        filtered = super()._reading()
        if not self.seen or not self.seen[-1]:
            return Reading(filtered.position_m, filtered.position_cov, self.velocity,
                           self.velocity_cov, filtered.axes, filtered.quads)
        place = self.places[-1]
        return Reading(place.mean, place.cov, self.velocity, self.velocity_cov, filtered.axes,
                       filtered.quads)

    def _profile(self) -> Profile:
        times = (np.array(self.at_ns) - self.at_ns[0]) * 1e-9
        return fitted_profile(times, np.array([p.mean for p in self.places]),
                              np.array([p.cov for p in self.places]))
