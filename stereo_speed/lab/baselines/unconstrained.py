# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``unconstrained``: the particle filter of the 2012 paper without the path, Section III.

Each particle is a plane with its quadrilateral that moves freely, six degrees of freedom with
constant rotational and translational velocities and Gaussian noise (eq. 9), weighed by both views
and across them (eq. 12-18), as ours are.  Where it differs in form:

- The rigid motion (eq. 6) is written about the front's centre and in the front's axes, not about
  the camera: 70 m from the camera a turn of 0.01 rad would be a jump of 0.7 m.  Constant rates
  are the same screw motions.
- The plane (eq. 10) and the quads (eq. 11) follow from the centre, the axes and the corners in
  3-D by projection: the same as the homographies of eq. 5 and 8, also under lens distortion.
- Deviations are rates per square root of a second, the speed's is that of our tracker.
- Resampled particles are spread anew by a Gaussian kernel of the cloud's own covariance
  (C. Musso, N. Oudjane, F. Le Gland, "Improving regularised particle filters", 2001), without
  which the depths that no image has yet told apart die out.

Whole passes are smoothed backwards from the cloud's means and covariances.
"""
from __future__ import annotations

import math
from typing import Optional

import numpy as np
from scipy.spatial.transform import Rotation

from .cloud import CloudTracker
from .settings import BaselineSettings
from ...core.records import Array, StereoPair
from ...tracking.front import onto_cross_plane
from ...tracking.initialise import Placement
from ...tracking.likelihood import Reference, score
from ...tracking.protocol import TrackStart

_SIDE_SHARE, _UP_SHARE = 0.05, 0.02  # 1-sigma of the first velocity across and up, as shares
_LEAST_NCC = 0.5
_CORNERS = slice(12, 20)


class UnconstrainedTracker(CloudTracker):
    """
    Free particles; see the module's docstring and :class:`Baseline`.

    A state is the centre (3), a rotation vector of the front against its first axes (3), the
    velocity (3) and the angular velocity (3) in the front's axes, and the corners on the plane
    (8): 20 numbers, of which the first 12 are the paper's 3-D sub-state.
    """

    freedom = 12

    def __init__(self, start: TrackStart, placed: Placement, settings: BaselineSettings) -> None:
        super().__init__(start, placed, settings)
        self.first_axes = self.lane.path.frame(np.array(self.placed.pose[0]))
        self.states = self._first_states()
        self.reference: Optional[Reference] = None
        # The homographies (eq. 5) depend on the motion over the distance alone: without a path
        # the scale of everything is that of the first depth, whatever the spread of the cloud.
        depth = self.placed.s_std_m / float(np.linalg.norm(self.states[:, :3].mean(axis=0)))
        self.calibration = math.hypot(self.calibration, depth)

    def _first_states(self) -> Array:
        """Depths on the ray of the mark as its scatter allows, and any likely velocity."""
        n, rng, pose = self.config.particles, self.rng, self.placed.pose
        limit, path = self.expected_mps, self.lane.path
        ds = self.placed.s_std_m * rng.standard_normal(n)
        uv = self.rig.left.project(path.position(np.array(pose[0])) + (
            pose[1:] + self.placed.front.corners_m) @ self.first_axes[:, 1:].T)[0]
        states = np.zeros((n, 20))
        for k, s_m in enumerate(pose[0] + ds):  # the same quad at each depth (Section III-A)
            quad = onto_cross_plane(path, self.rig.left, float(s_m), uv)
            offset = quad.mean(axis=0)
            at = np.array(s_m)
            states[k, :3] = path.position(at) + path.frame(at)[:, 1:] @ offset
            states[k, _CORNERS] = (quad - offset).ravel()
        speed = limit * (1 + self.config.initial_speed_std * rng.standard_normal(n))
        speed[: n // 4] = rng.uniform(0.0, 2.5 * limit, n // 4)
        states[:, 6] = np.maximum(speed, 0.0)
        states[:, 7] = _SIDE_SHARE * limit * rng.standard_normal(n)
        states[:, 8] = _UP_SHARE * limit * rng.standard_normal(n)
        states[:, 9:12] = self._spin_std() * rng.standard_normal((n, 3))
        return states

    def _spin_std(self) -> Array:
        """(3,) rates of the angular velocity about the heading, left and up axes."""
        tilt = self.settings.tilt_share
        return self.settings.rotation_rate_std * np.array([tilt, tilt, 1.0])

    # -- the filter's steps -----------------------------------------------------------------

    def _move(self, dt_s: float) -> None:
        """Carry on with constant velocities and their noise (eq. 6, 9, 10)."""
        n, root, states = len(self.states), np.sqrt(dt_s), self.states
        rate = self._manoeuvres(self.config.speed_rate_std, self.settings.along_rate_std)
        states[:, 6:9] += (rate * root)[:, None] * self.rng.standard_normal((n, 3))
        states[:, 9:12] += self._spin_std() * root * self.rng.standard_normal((n, 3))
        turn = Rotation.from_rotvec(states[:, 3:6])
        half = Rotation.from_rotvec(0.5 * dt_s * states[:, 9:12])
        states[:, :3] += dt_s * (turn * half).apply(states[:, 6:9]) @ self.first_axes.T
        states[:, 3:6] = (turn * half * half).as_rotvec()

    def _score(self, pair: StereoPair, lag_s: float) -> Array:
        return score(pair.left, pair.right, self._quads(self.states, lag_s), self.reference,
                     grid=self.grid, config=self.config).log_likelihood

    def _accept(self, pair: StereoPair, lag_s: float) -> bool:
        """Look at the mean state: blend it into the reference (eq. 14), or disown it."""
        quads = self._mean_quads(lag_s)
        at = score(pair.left, pair.right, quads, self.reference, grid=self.grid,
                   config=self.config)
        if not at.cross_ncc[0] > _LEAST_NCC:
            return False
        if self.reference is None:
            self.reference = Reference(at.left[0], at.right[0])
            return True
        alike = min(float(at.left[0] @ self.reference.left),
                    float(at.right[0] @ self.reference.right))
        if not alike > _LEAST_NCC:
            return False
        self.reference = self.reference.updated(
            at.left[0], at.right[0], self.config.reference_epsilon)
        return True

    # -- geometry ---------------------------------------------------------------------------

    def _quads(self, states: Array, lag_s: float = 0.0) -> tuple[Array, Array]:
        corners = self._corners(states)
        left = self.rig.left.project(corners)[0]
        late = corners + lag_s * self._velocities(states)[:, None]
        return left, self.rig.right.project(self.rig.to_right(late))[0]

    def _corners(self, states: Array) -> Array:
        """(N, 4, 3) corners in space."""
        axes = self._axes(states)
        return states[:, None, :3] + states[:, _CORNERS].reshape(-1, 4, 2) @ np.swapaxes(
            axes[:, :, 1:], 1, 2)

    def _axes(self, states: Array) -> Array:
        turn = Rotation.from_rotvec(states[:, 3:6]).as_matrix()
        return np.asarray(self.first_axes @ turn)

    def _centres(self, states: Array) -> Array:
        return states[:, :3]

    def _velocities(self, states: Array) -> Array:
        turn = Rotation.from_rotvec(states[:, 3:6])
        return np.asarray(turn.apply(states[:, 6:9]) @ self.first_axes.T)
