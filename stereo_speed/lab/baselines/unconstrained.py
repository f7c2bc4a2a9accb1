# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``unconstrained``: the particle filter of the 2012 paper without the path, Section III.

Each particle is a plane with its quadrilateral and six degrees of freedom, with constant
rotational and translational velocities and Gaussian noise (eq. 9), weighted by each view and
across the views (eq. 12-18), like ours.  It differs from the paper in form:

- The rigid motion (eq. 6) is written about the front's centre and in the front's axes, not about
  the camera: 70 m from the camera a rotation by 0.01 rad would be a jump of 0.7 m.  Constant rates
  are the same screw motions.
- The plane (eq. 10) and the quads (eq. 11) follow from the centre, the axes and the corners in
  3-D by projection: the same as the homographies of eq. 5 and 8, also under lens distortion.
- Deviations are rates per square root of a second; the speed's is that of our tracker.
- Resampled particles are spread by a Gaussian kernel of their own covariance (C. Musso,
  N. Oudjane, F. Le Gland, "Improving regularised particle filters", 2001), without which depths
  that no image has distinguished yet would die out.

Whole passes are smoothed backwards from the means and covariances of the particles.
"""
from __future__ import annotations

import math
from typing import Optional

import numpy as np
from scipy.spatial.transform import Rotation

from .particle_tracker import ParticleTracker
from .settings import UnconstrainedSettings
from ...core.records import Array, StereoPair
from ...tracking.front import onto_cross_plane
from ...tracking.initialise import first_states, Placement
from ...tracking.likelihood import Reference, score
from ...tracking.protocol import TrackStart
from ...vision.haar import PartGrid

_CORNERS = slice(12, 20)  # elements of a state


class UnconstrainedTracker(ParticleTracker[UnconstrainedSettings]):
    """
    Free particles; see the module's docstring and :class:`Baseline`.

    A state is the centre (3), a rotation vector of the front relative to its first axes (3), the
    velocity (3) and the angular velocity (3) in the front's axes, and the corners on the plane
    (8): 20 numbers, of which the first 12 are the paper's 3-D sub-state.
    """

    Settings = UnconstrainedSettings
    freedom = 12

    def __init__(self, start: TrackStart, placed: Placement, settings: UnconstrainedSettings
                 ) -> None:
        super().__init__(start, placed, settings)
        self.grid = PartGrid(self.config.parts, self.config.samples_per_part)
        self.first_axes = self.lane.path.frame(np.array(placed.pose[0]))
        self.states = self._first_states(start)
        self.reference: Optional[Reference] = None
        # The homographies (eq. 5) depend on the motion over the distance alone: without a path
        # the scale of everything is that of the first depth, whatever the particles' spread.
        depth = placed.s_std_m / float(np.linalg.norm(self.states[:, :3].mean(axis=0)))
        self.calibration = math.hypot(self.calibration, depth)

    def _first_states(self, start: TrackStart) -> Array:
        """Return states with depths on the first front's ray, and random likely velocities."""
        n, rng, pose = self.config.particles, self.rng, self.placed.pose
        path, along = self.lane.path, first_states(start, self.placed, self.placed.s_std_m)
        uv = self.rig.left.project(path.position(np.array(pose[0])) + (
            pose[1:] + self.placed.front.corners_m) @ self.first_axes[:, 1:].T)[0]
        states = np.zeros((n, 20))
        for k, s_m in enumerate(along[:, 0]):  # the same quad at each depth (Section III-A)
            quad = onto_cross_plane(path, self.rig.left, float(s_m), uv)
            offset = quad.mean(axis=0)
            at = np.array(s_m)
            states[k, :3] = path.position(at) + path.frame(at)[:, 1:] @ offset
            states[k, _CORNERS] = (quad - offset).ravel()
        side, climb = self.settings.first_side_share, self.settings.first_climb_share
        states[:, 6] = along[:, 3]
        states[:, 7] = side * start.expected_mps * rng.standard_normal(n)
        states[:, 8] = climb * start.expected_mps * rng.standard_normal(n)
        states[:, 9:12] = self._spin_std() * rng.standard_normal((n, 3))
        return states

    def _spin_std(self) -> Array:
        """Return the (3,) noise rates of the angular velocity about heading, left and up."""
        tilt = self.settings.tilt_share
        return self.settings.rotation_rate_std * np.array([tilt, tilt, 1.0])

    # -- the filter's steps -----------------------------------------------------------------

    def _move(self, dt_s: float) -> None:
        """Move the particles with constant velocities and their noise (eq. 6, 9, 10)."""
        n, root, states = len(self.states), np.sqrt(dt_s), self.states
        rate = self._manoeuvres(self.config.speed_rate_std, self.settings.along_rate_std)
        states[:, 6:9] += (rate * root)[:, None] * self.rng.standard_normal((n, 3))
        states[:, 9:12] += self._spin_std() * root * self.rng.standard_normal((n, 3))
        rotation = Rotation.from_rotvec(states[:, 3:6])
        half = Rotation.from_rotvec(0.5 * dt_s * states[:, 9:12])
        states[:, :3] += dt_s * (rotation * half).apply(states[:, 6:9]) @ self.first_axes.T
        states[:, 3:6] = (rotation * half * half).as_rotvec()

    def _score(self, pair: StereoPair) -> Array:
        quads = self._quads(self.states, pair.right_lag_s)
        return score(pair.left, pair.right, quads, self.reference, grid=self.grid,
                     config=self.config).log_likelihood

    def _accept(self, pair: StereoPair) -> bool:
        """Return whether the mean state shows the vehicle; update the reference (eq. 14)."""
        quads = self._mean_quads(pair.right_lag_s)
        at = score(pair.left, pair.right, quads, self.reference, grid=self.grid,
                   config=self.config)
        least_ncc = self.config.visibility.least_ncc
        if not at.cross_ncc[0] > least_ncc:
            return False
        if self.reference is None:
            self.reference = Reference(at.left[0], at.right[0])
            return True
        alike = min(float(at.left[0] @ self.reference.left),
                    float(at.right[0] @ self.reference.right))
        if not alike > least_ncc:
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
        """Return the (N, 4, 3) corners in 3-D, m."""
        axes = self._axes(states)
        return states[:, None, :3] + states[:, _CORNERS].reshape(-1, 4, 2) @ np.swapaxes(
            axes[:, :, 1:], 1, 2)

    def _axes(self, states: Array) -> Array:
        return np.asarray(self.first_axes @ Rotation.from_rotvec(states[:, 3:6]).as_matrix())

    def _centres(self, states: Array) -> Array:
        return states[:, :3]

    def _velocities(self, states: Array) -> Array:
        rotation = Rotation.from_rotvec(states[:, 3:6])
        return np.asarray(rotation.apply(states[:, 6:9]) @ self.first_axes.T)
