# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A front followed by its points: the part that all trackers of points share.

In every pair the points tell, through the triangulation of Hartley and Sturm, where the front is
(``places``), and a Kalman filter of constant velocity takes that in with the covariance of
Matthies and Shafer.  What a tracker then reports is its own affair.
"""
from __future__ import annotations

from abc import abstractmethod
from typing import Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from .common import Baseline, Reading
from .constant_velocity import (
    correct, directional_rate, distance2, Gaussian, predict, Transition, transition)
from .hartley_sturm import triangulate
from .places import Place, place_of_front
from .points import Aim, near_quad, Points, PointSource
from .settings import BaselineSettings
from .speed_profile import Profile, smoothed_profile
from ...core.records import Array, Reason, StereoPair
from ...road.path import frame_of
from ...tracking.initialise import Placement
from ...tracking.protocol import TrackStart

_GATE = 16.3  # squared Mahalanobis distance: one in a thousand is beyond
_LEEWAY_M = 0.2  # jolts of the vehicle or the cameras, which no model of motion foresees
_SLOW_MPS = 2.0  # what hardly moves keeps its heading
_SIDE_SHARE = 0.1  # 1-sigma of the first velocity across the lane, as a share
_UP_SHARE = 0.02
_INLIER_PX = 1.5
_LEAST_LINKS = 3
_SLACK_SIGMAS = 2.5


class PointTracker(Baseline):
    """Follow a front by its points; see the module's docstring and :class:`Baseline`."""

    unseen_reason = Reason.TOO_FEW_FEATURES

    def __init__(self, start: TrackStart, placed: Placement, settings: BaselineSettings) -> None:
        super().__init__(start, placed, settings)
        self.source, self.std_px = self._source()
        pose = self.placed.pose
        at = np.array(pose[0])
        self.axes = self.lane.path.frame(at)
        self.up = self.axes[:, 2]
        place = self.placed.front.centre(pose)
        self.centre_px = self.rig.project(place[None])[0][0]
        self.belief = self._first_belief(place)
        self.before = self._quads(place)[0]
        self.points: Optional[Points] = None
        self.place: Optional[Place] = None
        self.filtered: list[Gaussian] = []
        self.steps: list[Transition] = []
        self.seen: list[bool] = []
        self._step = transition(0.0, np.zeros((3, 3)))

    @abstractmethod
    def _source(self) -> tuple[PointSource, float]:
        """Give the source of points, and their matching error in px."""

    def _first_belief(self, place: Array) -> Gaussian:
        """Take the place from the mark, and the velocity from the speed limit."""
        velocity, std = self._first_velocity()
        toward = np.array([1.0, *self.placed.offset_slope]) @ self.axes.T
        depth = self.placed.s_std_m ** 2 * np.outer(toward, toward)
        side = 1e-4 * np.eye(3) * (place[2] / 50) ** 2
        shares = np.array([std, _SIDE_SHARE * self.expected_mps, _UP_SHARE * self.expected_mps])
        cov = np.zeros((6, 6))
        cov[:3, :3] = depth + side
        cov[3:, 3:] = self.axes @ np.diag(shares ** 2) @ self.axes.T
        return Gaussian(np.concatenate([place, velocity]), cov)

    # -- the steps of the filter ------------------------------------------------------------

    def _predict(self, dt_s: float) -> None:
        """Carry the belief on at constant velocity, and turn the front with it."""
        velocity = self.belief.mean[3:]
        if np.linalg.norm(velocity) > _SLOW_MPS:
            self.axes = frame_of(velocity / np.linalg.norm(velocity), self.up)
        rate = directional_rate(
            self.axes[:, 0], self.up, self.settings.along_rate_std, self.settings.turn_rate_std,
            self.settings.climb_rate_std)
        self._step = transition(dt_s, rate)
        self.belief = predict(self.belief, self._step)

    def _observe(self, pair: StereoPair, lag_s: float) -> bool:
        """Measure the place of the front and take it in."""
        seen = self._measure(pair, lag_s)
        if self.filtered:
            self.steps.append(self._step)
        self.filtered.append(self.belief)
        self.seen.append(seen)
        return seen

    def _measure(self, pair: StereoPair, lag_s: float) -> bool:
        left, right = self._quads(self.belief.mean[:3])
        shift = self._late_px(lag_s)
        aim = Aim(left, right + shift, self.before, self._slack_px(float(np.ptp(left[:, 0]))))
        found = self.source.observe(pair, aim)
        predicted = self.rig.project(self.belief.mean[None, :3])[0][0]
        points, centre_px = self._linked(found, predicted)
        # What lies around the front is background, which must not be taken along.
        points = points.only(near_quad(points.left, left + (centre_px - predicted), 1.0))
        both = points.only(points.matched)
        xyz = triangulate(self.rig, both.left, both.right - shift)
        good = np.asarray(np.isfinite(xyz).all(axis=1))
        both, xyz = both.only(good), xyz[good]
        place = place_of_front(self.rig, xyz, centre_px, self.axes[:, 0], self.std_px)
        self.before = left  # the source looked there; overwritten when the vehicle is there
        if place is None or self._unlikely(place):
            return False
        place = self._on_springs(place)
        self.belief = correct(self.belief, place.mean, place.cov)
        self._take_in(both.ids[place.used], xyz[place.used], place, pair)
        self.points, self.place, self.centre_px = points, place, centre_px
        self.before = self._quads(self.belief.mean[:3])[0]
        return True

    def _unlikely(self, place: Place) -> bool:
        """Whether a place is too far from the expected one to be the same vehicle's."""
        return distance2(self.belief, place.mean, place.cov + _LEEWAY_M ** 2 * np.eye(3)) > _GATE

    def _on_springs(self, place: Place) -> Place:
        """Allow for a front that bounces: its height is not that of the vehicle's way."""
        bounce = self.settings.bounce_std_m ** 2 * np.outer(self.up, self.up)
        return Place(place.mean, place.cov + bounce, place.used)

    def _take_in(self, ids: NDArray[np.int64], xyz: Array, place: Place,
                 pair: StereoPair) -> None:
        """
        Use the points for more than their place.

        :param ids: (n,) of the points that agree.
        :param xyz: (n, 3) where they are, m.
        :param place: the place of the front.
        :param pair: the pair.
        """

    def _linked(self, found: Points, predicted: Array) -> tuple[Points, Array]:
        """
        Carry the front's centre on by the points seen before; drop those that moved otherwise.

        :param predicted: (2,) where the centre is expected in the raw left view, px.
        :return: the points that are left and the centre (2,) in the raw left view, px.
        """
        if self.points is None:
            return found, self.centre_px
        _, a, b = np.intersect1d(self.points.ids, found.ids, return_indices=True)
        if len(a) < _LEAST_LINKS:
            return found, predicted
        before, after = self.points.left[a], found.left[b]
        similarity, inliers = cv2.estimateAffinePartial2D(
            before, after, method=cv2.RANSAC, ransacReprojThreshold=_INLIER_PX, maxIters=500)
        if similarity is None or inliers.sum() < _LEAST_LINKS:
            return found, predicted
        keep = np.ones(len(found.ids), bool)
        keep[b[inliers[:, 0] == 0]] = False
        return found.only(keep), similarity[:, :2] @ self.centre_px + similarity[:, 2]

    # -- where to look ----------------------------------------------------------------------

    def _quads(self, place: Array) -> tuple[Array, Array]:
        """Corners (4, 2) of the front at a place, in both raw views."""
        corners = place + self.placed.front.corners_m @ self.axes[:, 1:].T
        left, right, _, _ = self.rig.project(corners)
        return left, right

    def _late_px(self, lag_s: float) -> Array:
        """How far the front moves in the right view in between two exposures, (2,) px."""
        if lag_s == 0:
            return np.zeros(2)
        here, velocity = self.belief.mean[:3], self.belief.mean[3:]
        at = self.rig.project(np.stack([here, here + lag_s * velocity]))[1]
        return np.asarray(at[1] - at[0])

    def _slack_px(self, width_px: float) -> float:
        """How far the front may be from where it is expected in the left view."""
        values, vectors = np.linalg.eigh(self.belief.cov[:3, :3])
        steps = _SLACK_SIGMAS * np.sqrt(np.maximum(values, 0.0)) * vectors
        uv = self.rig.project(self.belief.mean[:3] + np.concatenate([[0 * values], steps.T]))[0]
        off = np.linalg.norm(uv[1:] - uv[0], axis=1)
        far = float(off.max()) if np.isfinite(off).all() else width_px
        return 2.0 + min(far, 0.5 * width_px)

    # -- what is told -----------------------------------------------------------------------

    def _reading(self) -> Reading:
        mean, cov = self.belief.mean, self.belief.cov
        return Reading(mean[:3], cov[:3, :3], mean[3:], cov[3:, 3:], self.axes,
                       self._quads(mean[:3]))

    def _profile(self) -> Profile:
        return smoothed_profile(self.filtered, self.steps, self.seen)
