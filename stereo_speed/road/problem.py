# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The least-squares problem of a road: picks, and how far they lie from their projected lines."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Optional

import numpy as np

from .model import RoadModel, turn_matrix, Weights
from ..core.records import Array
from ..geometry.camera import Camera
from ..geometry.rig import StereoRig

PICK_STD_PX = 0.3  # what a careful person reaches; of picks that come without a 1-sigma
ROLL_STD_RAD = 0.1  # of the road about its direction, against the camera's up
BEND_STD = (0.06, 0.04)  # grade and crossfall of a bent surface, rad
CREST_STD_PER_M = 1 / 800  # vertical curvature
TURN_STEP_RAD = 1e-6  # moves the picks by something like 1e-3 px


@dataclass(frozen=True, eq=False)
class Picks:
    """
    All picks of a road's lines.

    :param uv_px: (n, 2) raw pixels.
    :param line: (n,) number of the line.
    :param right: (n,) whether it is of the right view.
    :param std_px: (n,) 1-sigma across the line.
    """

    uv_px: Array
    line: Array
    right: Array
    std_px: Array

    @classmethod
    def of(cls, lines: Mapping[str, tuple[Array, Array]],
           std_px: Optional[Mapping[str, tuple[Array, Array]]] = None) -> Picks:
        """
        Gather the picks of named lines.

        :param lines: name to (left (n, 2), right (m, 2)).
        :param std_px: name to (left (n,), right (m,)) 1-sigmas; those of careful clicks for
            lines that are not named.
        """
        given = std_px or {}
        parts = [(view, i, j) for i, pair in enumerate(lines.values())
                 for j, view in enumerate(pair)]
        stds = [given[name][j] if name in given else np.full(len(pair[j]), PICK_STD_PX)
                for name, pair in lines.items() for j in (0, 1)]
        return cls(np.concatenate([view for view, _, _ in parts]).astype(np.float64),
                   np.concatenate([np.full(len(view), i) for view, i, _ in parts]),
                   np.concatenate([np.full(len(view), j == 1) for view, _, j in parts]),
                   np.concatenate(stds).astype(np.float64))


@dataclass(frozen=True, eq=False)
class Feet:
    """
    Where the picks meet their lines.

    :param s_m: (n,) reference arc length of the foot of each pick.
    :param normal: (n, 2) unit normal of the projected line there.
    :param residual_px: (n,) signed distance of the pick from it.
    """

    s_m: Array
    normal: Array
    residual_px: Array


def pixels(camera: Camera, points_m: Array) -> Array:
    """Project points (..., 3) of the camera's frame to raw pixels; NaN behind the camera."""
    z = points_m[..., 2:]
    return camera.distort(points_m[..., :2] / np.where(z > 0.1, z, np.nan))


@dataclass(frozen=True, eq=False)
class TurnPrior:
    """
    What is known beforehand of how the right camera has turned since the calibration.

    :param mean_rad: (3,) pan, tilt and roll.
    :param root: (n, 3) such that ``root @ (turn - mean_rad)`` has unit covariance.
    """

    mean_rad: Array
    root: Array

    @classmethod
    def loose(cls, std_rad: float) -> TurnPrior:
        """Make one about no turn at all."""
        return cls(np.zeros(3), np.eye(3) / std_rad)


class RoadProblem:
    """
    The residuals of a road model and their derivatives.

    :param rig: the calibrated rig.
    :param picks: of all lines.
    :param model: the family of roads.
    :param turn: what is known of the turn of the right camera, whose angles are then the last
        three unknowns. None: it stands as calibrated.
    """

    def __init__(self, rig: StereoRig, picks: Picks, model: RoadModel,
                 turn: Optional[TurnPrior] = None) -> None:
        self.rig, self.picks, self.model = rig, picks, model
        self.turn = turn
        self.steps = model.steps if turn is None else np.append(
            model.steps, np.full(3, TURN_STEP_RAD))
        self._last: Optional[tuple[Array, Feet]] = None
        self._known: Optional[tuple[Array, tuple[Array, Array]]] = None

    @property
    def size(self) -> int:
        """Count the unknowns."""
        return len(self.steps)

    def _reference(self, x: Array) -> tuple[Array, Array]:
        """Give the reference line of the model; the last one is kept."""
        if self._known is None or not np.array_equal(self._known[0], x):
            self._known = x.copy(), self.model.reference(x)
        return self._known[1]

    def turn_rad(self, x: Array) -> Array:
        """Take pan, tilt and roll (..., 3) of the right camera; zeros where they are fixed."""
        if self.turn is None:
            return np.zeros(x.shape[:-1] + (3,))
        return x[..., -3:]

    def to_right(self, x: Array, points_m: Array) -> Array:
        """Carry points (..., n, 3) into the frame of the right camera as it stands now."""
        right = self.rig.to_right(points_m)
        return right if self.turn is None else right @ turn_matrix(self.turn_rad(x))

    def at(self, x: Array, weights: Weights) -> Array:
        """Give the pixels (..., n, 2) of the lines at fixed arc lengths, one for each pick."""
        points, frames = self._reference(x)
        return self._seen(x, (points, frames[..., 1]), weights)

    def _seen(self, x: Array, reference: tuple[Array, Array], weights: Weights) -> Array:
        """Place a point on the line of each pick and project it into the view of the pick."""
        points, left = (weights(values) for values in reference)
        points = points + self.model.offsets(x)[..., self.picks.line, None] * left
        uv_px, right = np.empty(points.shape[:-1] + (2,)), self.picks.right
        uv_px[..., ~right, :] = pixels(self.rig.left, points[..., ~right, :])
        uv_px[..., right, :] = pixels(
            self.rig.right, self.to_right(x, points[..., right, :]))
        return uv_px

    def feet(self, x: Array) -> Feet:
        """Find where each pick meets its projected line."""
        if self._last is not None and np.array_equal(self._last[0], x):
            return self._last[1]
        points, frames = self._reference(x)
        reference = points, frames[..., 1]
        nodes, h = self.model.s_m, 0.01
        s, reach = nodes[self._nearest_nodes(x, reference)], 3 * (nodes[1] - nodes[0])
        for _ in range(3):
            here, after = (self._seen(x, reference, Weights.at(nodes, s + d))
                           for d in (-h, h))
            tangent, off = (after - here) / (2 * h), self.picks.uv_px - (here + after) / 2
            step = np.sum(off * tangent, -1) / np.sum(tangent * tangent, -1)
            s = np.clip(s + np.nan_to_num(np.clip(step, -reach, reach)),
                        1.3 * nodes[0], 1.3 * nodes[-1])
        length = np.linalg.norm(tangent, axis=-1, keepdims=True)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / length
        off = self.picks.uv_px - self._seen(x, reference, Weights.at(nodes, s))
        residual = np.sum(normal * off, axis=-1)
        lost = ~np.isfinite(residual)  # behind a camera: far off, and no slope
        feet = Feet(s, np.where(lost[:, None], 0.0, normal), np.where(lost, 1e3, residual))
        self._last = x.copy(), feet
        return feet

    def _nearest_nodes(self, x: Array, reference: tuple[Array, Array]) -> Array:
        """Give the node (n,) whose projection is nearest to each pick."""
        lines = reference[0] + self.model.offsets(x)[:, None, None] * reference[1]
        views = (pixels(self.rig.left, lines), pixels(self.rig.right, self.to_right(x, lines)))
        nearest = np.zeros(len(self.picks.line), dtype=int)
        for i in range(self.model.lines):
            for right in (False, True):
                mine = (self.picks.line == i) & (self.picks.right == right)
                gap = self.picks.uv_px[mine, None] - views[int(right)][i]
                square = np.sum(gap * gap, axis=-1)
                nearest[mine] = np.argmin(np.where(np.isnan(square), np.inf, square), axis=-1)
        return nearest

    def priors(self, x: Array) -> Array:
        """
        Give weak constraints as (..., 4 and more) residuals in sigmas.

        They are roll, grade, crossfall and crest, and the turn of the right camera.
        """
        up = (self._reference(x)[1])[..., len(self.model.s_m) // 2, :, :]
        bend = self.model.bend(x)
        roll = up[..., 1, 1]  # how far the left axis dips below the camera's horizontal
        crest = bend[..., 2] / (self.model.half_length_m * CREST_STD_PER_M)
        weak = np.stack([roll / ROLL_STD_RAD, bend[..., 0] / BEND_STD[0],
                         bend[..., 1] / BEND_STD[1], crest], axis=-1)
        if self.turn is None:
            return weak
        turned = (self.turn_rad(x) - self.turn.mean_rad) @ self.turn.root.T
        return np.concatenate([weak, turned], axis=-1)

    def residuals(self, x: Array) -> Array:
        """Give all residuals in sigmas."""
        return np.append(self.feet(x).residual_px / self.picks.std_px, self.priors(x))

    def jacobian(self, x: Array) -> Array:
        """Differentiate; moving a foot along its line changes nothing, so feet stay."""
        feet, steps = self.feet(x), self.steps
        weights = Weights.at(self.model.s_m, feet.s_m)
        both = x + np.concatenate([np.diag(steps), -np.diag(steps)])
        uv = self.at(both, weights)
        moved = np.concatenate(
            [-np.sum(np.nan_to_num(uv) * feet.normal, axis=-1) / self.picks.std_px,
             self.priors(both)], axis=-1)
        return ((moved[:len(steps)] - moved[len(steps):]) / (2 * steps[:, None])).T
