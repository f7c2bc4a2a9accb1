# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Tracking of a front by its points: the common part of all point trackers.

In every pair the points are triangulated (Hartley and Sturm) and give the position of the front
(``front_position``), which updates a Kalman filter of constant velocity with the covariance of
Matthies and Shafer.  Each tracker then decides what it reports.
"""
from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Optional, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from .baseline import Baseline, Estimate
from .constant_velocity import (
    correct, directional_rate, distance2, Gaussian, predict, transition)
from .front_position import Measurement, position_of_front
from .hartley_sturm import triangulate
from .points import ExpectedFront, near_quad, Points, PointSource
from .settings import PointSettings
from ...core.passes import Reason
from ...core.records import Array, StereoPair
from ...road.path import frame_of
from ...tracking.initialise import Placement
from ...tracking.protocol import TrackStart
from ...vision.grey import to_eight_bits

OwnSettings = TypeVar('OwnSettings', bound=PointSettings)

_SLOW_MPS = 2.0  # below this speed the heading is kept
_SLACK_SIGMAS = 2.5  # sigmas of the predicted position within which points are searched
_LEAST_SLACK_PX = 2.0  # least search distance


class PointTracker(Baseline[OwnSettings]):
    """Track a front by its points; see the module's docstring and :class:`Baseline`."""

    unseen_reason = Reason.TOO_FEW_FEATURES

    def __init__(self, start: TrackStart, placed: Placement, settings: OwnSettings) -> None:
        super().__init__(start, placed, settings)
        self.source = self._source()
        self.axes = self.lane.path.frame(np.array(placed.pose[0]))
        self.up = self.axes[:, 2]
        position = placed.front.centre(placed.pose)
        self.centre_px = self.rig.project(position[None])[0][0]
        self.belief = self._first_belief(start, position)
        self.before = self._quads(position)[0]
        self.points: Optional[Points] = None
        self._step = transition(0.0, np.zeros((3, 3)))

    @abstractmethod
    def _source(self) -> PointSource:
        """Return the source of points."""

    def _first_belief(self, start: TrackStart, position: Array) -> Gaussian:
        """Return the belief at the start: the first front's position and the expected velocity."""
        toward = np.array([1.0, *self.placed.offset_slope]) @ self.axes.T
        depth = self.placed.s_std_m ** 2 * np.outer(toward, toward)
        side = 1e-4 * np.eye(3) * (position[2] / 50) ** 2
        stds = np.array([start.expected_std_mps,
                         self.settings.first_side_share * start.expected_mps,
                         self.settings.first_climb_share * start.expected_mps])
        cov = np.zeros((6, 6))
        cov[:3, :3] = depth + side
        cov[3:, 3:] = self.axes @ np.diag(stds ** 2) @ self.axes.T
        velocity = start.expected_mps * self.axes[:, 0]
        return Gaussian(np.concatenate([position, velocity]), cov)

    # -- the steps of the filter ------------------------------------------------------------

    def _predict(self, dt_s: float) -> None:
        """Predict the belief with constant velocity, and turn the front with the velocity."""
        velocity = self.belief.mean[3:]
        if np.linalg.norm(velocity) > _SLOW_MPS:
            self.axes = frame_of(velocity / np.linalg.norm(velocity), self.up)
        rate = directional_rate(
            self.axes[:, 0], self.up, self.settings.along_rate_std, self.settings.across_rate_std,
            self.settings.climb_rate_std)
        self._step = transition(dt_s, rate)
        self.belief = predict(self.belief, self._step)

    def _observe(self, pair: StereoPair) -> bool:
        """Measure the position of the front, and update the belief."""
        eight = replace(pair, left=to_eight_bits(pair.left), right=to_eight_bits(pair.right))
        seen = self._measure(eight)
        if self.filtered:
            self.steps.append(self._step)
        self.filtered.append(self.belief)
        self.seen.append(seen)
        return seen

    def _measure(self, pair: StereoPair) -> bool:
        left, right = self._quads(self.belief.mean[:3])
        shift = self._motion_px(pair.right_lag_s)
        found = self.source.observe(pair, ExpectedFront(
            left, right + shift, self.before, self._slack_px(float(np.ptp(left[:, 0])))))
        predicted = self.rig.project(self.belief.mean[None, :3])[0][0]
        points, centre_px = self._carried_on(found, predicted)
        # Points around the front are background and must be dropped.
        points = points.only(near_quad(points.left, left + (centre_px - predicted), 1.0))
        both = points.only(points.matched)
        xyz = triangulate(self.rig, both.left, both.right - shift)
        good = np.asarray(np.isfinite(xyz).all(axis=1))
        both, xyz = both.only(good), xyz[good]
        position = position_of_front(self.rig, xyz, centre_px, self.axes[:, 0], self.settings)
        self.before = left  # where the source searched; overwritten if the vehicle is found
        if position is None or self._unlikely(position):
            return False
        position = self._on_springs(position)
        self.belief = correct(self.belief, position.mean, position.cov)
        self._use_points(both.ids[position.used], xyz[position.used], position, pair)
        self.points, self.centre_px = points, centre_px
        self.before = self._quads(self.belief.mean[:3])[0]
        return True

    def _unlikely(self, position: Measurement) -> bool:
        """Return whether a position is too far from the prediction to be the vehicle's."""
        jolts = self.settings.jolt_std_m ** 2 * np.eye(3)
        return distance2(self.belief, position.mean, position.cov + jolts) \
            > self.settings.most_distance2

    def _on_springs(self, position: Measurement) -> Measurement:
        """Return a position with the covariance of the bouncing on the springs added."""
        bounce = self.settings.bounce_std_m ** 2 * np.outer(self.up, self.up)
        return replace(position, cov=position.cov + bounce)

    def _use_points(self, ids: NDArray[np.int64], xyz: Array, position: Measurement,
                    pair: StereoPair) -> None:
        """
        Use the points for more than the position of the front.

        :param ids: (n,), ids of the points that agree.
        :param xyz: (n, 3), their positions, m.
        :param position: position of the front.
        :param pair: the pair.
        """

    def _carried_on(self, found: Points, predicted: Array) -> tuple[Points, Array]:
        """
        Return the points that move with the front, and the centre moved with them.

        :param predicted: (2,), expected centre in the raw left view, px.
        :return: the remaining points, and the centre (2,) in the raw left view, px.
        """
        if self.points is None:
            return found, self.centre_px
        least = self.settings.least_points
        _, a, b = np.intersect1d(self.points.ids, found.ids, return_indices=True)
        if len(a) < least:
            return found, predicted
        similarity, inliers = cv2.estimateAffinePartial2D(
            self.points.left[a], found.left[b], method=cv2.RANSAC,
            ransacReprojThreshold=self.settings.most_motion_error_px, maxIters=500)
        if similarity is None or inliers.sum() < least:
            return found, predicted
        keep = np.ones(len(found.ids), bool)
        keep[b[inliers[:, 0] == 0]] = False
        return found.only(keep), similarity[:, :2] @ self.centre_px + similarity[:, 2]

    # -- search regions --------------------------------------------------------------------

    def _quads(self, position: Array) -> tuple[Array, Array]:
        """Return the corners (4, 2) of the front at a position, in both raw views."""
        left, right, _, _ = self.rig.project(
            position + self.placed.front.corners_m @ self.axes[:, 1:].T)
        return left, right

    def _motion_px(self, lag_s: float) -> Array:
        """Return the front's motion in the right view between the two exposures, (2,) px."""
        if lag_s == 0:
            return np.zeros(2)
        here, velocity = self.belief.mean[:3], self.belief.mean[3:]
        at = self.rig.project(np.stack([here, here + lag_s * velocity]))[1]
        return np.asarray(at[1] - at[0])

    def _slack_px(self, width_px: float) -> float:
        """Return how far the front may be from its expected position in the left view."""
        values, vectors = np.linalg.eigh(self.belief.cov[:3, :3])
        steps = _SLACK_SIGMAS * np.sqrt(np.maximum(values, 0.0)) * vectors
        uv = self.rig.project(self.belief.mean[:3] + np.concatenate([[0 * values], steps.T]))[0]
        off = np.linalg.norm(uv[1:] - uv[0], axis=1)
        far = float(off.max()) if np.isfinite(off).all() else width_px
        return _LEAST_SLACK_PX + min(far, 0.5 * width_px)

    # -- what is reported -------------------------------------------------------------------

    def _estimate(self) -> Estimate:
        mean, cov = self.belief.mean, self.belief.cov
        return Estimate(mean[:3], cov[:3, :3], mean[3:], cov[3:, 3:], self.axes,
                        self._quads(mean[:3]))
