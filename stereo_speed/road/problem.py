# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The least-squares problem of a road: picks, and how far they lie from their projected lines."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Optional

import numpy as np
from numpy.typing import NDArray

from .model import drift_matrix, RoadModel, Weights
from .wander import MayWander, Wander
from ..core.config import CheckedRecord, parameter
from ..core.records import Array
from ..geometry.camera import Camera
from ..geometry.rig import StereoRig

_DRIFT_STEP_RAD = 1e-6  # moves the picks by something like 1e-3 px
_NEAREST_M = 0.1  # what is nearer to a camera's plane is not seen
_STEP_M = 0.01  # along a line, of its direction in the image
_LOST_PX = 1e3  # residual of a pick whose line is behind the camera: far off, without a slope
_ASTRAY_PX = 60.0  # a pick further from its line says nothing of which of its parts it is of
_LEAST_TAPER_M = 1e-6  # stands for lines that are parallel without a doubt
_WANDERS = (1 / 3, 1.0, 3.0)  # that are tried, of the usual one
_ALIKE = 0.5  # lines of other roads, which tell as little of one's as is known beforehand
REACH = 1.3  # half lengths from the middle of the road to where feet are looked for


@dataclass(frozen=True)
class RoadPrior(CheckedRecord):
    """What is known of any road and rig before their lines are looked at."""

    pick_std_px: float = parameter(
        0.3, 0.01, 10.0, 'px', '1-sigma of a point that a careful person clicked, across its line')
    best_pick_std_px: float = parameter(
        0.02, 0.0, 10.0, 'px', 'no points of a line agree with a road better than this')
    roll_std_rad: float = parameter(
        0.1, 1e-3, 3.0, 'rad', "1-sigma of the road's roll about its direction against the "
        "camera's up, for one straight line says nothing of it")
    grade_std_rad: float = parameter(
        0.06, 1e-4, 1.0, 'rad', '1-sigma of the grade of a curved road against its plane')
    crossfall_std_rad: float = parameter(
        0.04, 1e-4, 1.0, 'rad', '1-sigma of the crossfall of a curved road against its plane')
    curvature_std_per_m: float = parameter(
        0.02, 1e-5, 1.0, '1/m', '1-sigma of the curvature of a road that is not straight')
    crest_std_per_m: float = parameter(
        1 / 400, 1e-6, 1.0, '1/m', '1-sigma of the vertical curvature of a road whose grade '
        'changes; crests are built with radii from 200 m at 30 km/h to 5000 m at 100 km/h')
    twist_std_rad: float = parameter(
        0.04, 1e-4, 1.0, 'rad', '1-sigma of the change of the crossfall over half the road, where '
        'it changes; superelevation is built up to 8 %')
    vertical_curve_m: float = parameter(
        40.0, 1.0, 1000.0, 'm', 'usual length of a vertical curve, over which one grade goes over '
        'into another')
    vertical_curve_log_std: float = parameter(
        0.7, 0.01, 5.0, '', '1-sigma of the natural logarithm of that length')
    run_off_m: float = parameter(
        30.0, 1.0, 1000.0, 'm', 'usual length of a run-off, over which one crossfall goes over '
        'into another')
    run_off_log_std: float = parameter(
        0.7, 0.01, 5.0, '', '1-sigma of the natural logarithm of that length')
    run_off_axis_std_m: float = parameter(
        5.0, 0.01, 100.0, 'm', '1-sigma of where, beside the middle of the lines, the line lies '
        'about which the road turns there: its middle or an edge')
    transition_m: float = parameter(
        40.0, 1.0, 1000.0, 'm', 'usual length of a transition, over which one curvature goes over '
        'into another')
    transition_log_std: float = parameter(
        0.7, 0.01, 5.0, '', '1-sigma of the natural logarithm of that length')
    bent_probability: float = parameter(
        0.1, 1e-6, 0.9, '', 'probability, beforehand, of each number more that describes how a '
        'road bends, and of a bend that lies in a plane; a clothoid is as common as an arc')
    taper_std_m: float = parameter(
        0.003, 0.0, 1.0, 'm', '1-sigma by which a line runs off from the others over half of the '
        'road: so parallel are lines that are to show a rotation of a camera')
    wander_std_m: float = parameter(
        0.003, 1e-6, 1.0, 'm', '1-sigma by which a line is off its place, together over some way, '
        'where it wanders; a third of it and three times as much are weighed as well')
    wander_length_m: float = parameter(
        20.0, 0.1, 1000.0, 'm', 'how far along a line that is off together; rather too far, for '
        'picks that are near each other hardly tell it')
    wander_probability: float = parameter(
        0.2, 0.0, 0.99, '', 'share of lines that wander, beforehand; 0: none does')
    survey_std_m: float = parameter(
        0.03, 0.0, 10.0, 'm', '1-sigma of a given or surveyed point across its line, where the '
        'site does not say; neighbours are wrong together')
    calibrated_std_deg: float = parameter(
        0.0003, 0.0, 1.0, 'degrees', '1-sigma of each angle between cameras that nobody has '
        'touched since their calibration')

    @property
    def may_wander(self) -> MayWander:
        """Return what is known of how far lines wander."""
        chance = self.wander_probability
        if not chance:
            return MayWander((0.0,), (1.0,))
        return MayWander(
            (0.0, *(share * self.wander_std_m for share in _WANDERS)),
            (_ALIKE * (1 - chance), *[_ALIKE * chance / len(_WANDERS)] * len(_WANDERS)))

    @property
    def calibrated_covariance_rad2(self) -> Array:
        """Return the covariance (3, 3) of pan, tilt and roll of a rig as calibrated."""
        return np.asarray(np.radians(self.calibrated_std_deg) ** 2 * np.eye(3))


@dataclass(frozen=True, eq=False)
class Picks:
    """
    All picks of a road's lines.

    :param names: of the lines, in the order of their numbers.
    :param uv_px: (n, 2) raw pixels.
    :param line: (n,) number of the line.
    :param right: (n,) whether it is of the right view.
    :param std_px: (n,) 1-sigma across the line.
    """

    names: tuple[str, ...]
    uv_px: Array
    line: NDArray[np.intp]
    right: NDArray[np.bool_]
    std_px: Array

    @classmethod
    def of(cls, lines: Mapping[str, tuple[Array, Array]],
           std_px: Optional[Mapping[str, tuple[Array, Array]]] = None,
           click_std_px: float = RoadPrior().pick_std_px) -> Picks:
        """
        Return the picks of named lines.

        :param lines: name to (left (n, 2), right (m, 2)).
        :param std_px: name to (left (n,), right (m,)) 1-sigmas.
        :param click_std_px: 1-sigma of the picks of lines that are not named there.
        """
        given = std_px or {}
        parts = [(view, i, j) for i, pair in enumerate(lines.values())
                 for j, view in enumerate(pair)]
        stds = [given[name][j] if name in given else np.full(len(pair[j]), click_std_px)
                for name, pair in lines.items() for j in (0, 1)]
        return cls(tuple(lines),
                   np.concatenate([view for view, _, _ in parts]).astype(np.float64),
                   np.concatenate([np.full(len(view), i) for view, i, _ in parts]),
                   np.concatenate([np.full(len(view), j == 1) for view, _, j in parts]),
                   np.concatenate(stds).astype(np.float64))

    def of_line(self, line: int, right: bool) -> NDArray[np.bool_]:
        """
        Return which picks (n,) are of a line in one view.

        :param line: its number.
        :param right: the right view.
        """
        return np.asarray((self.line == line) & (self.right == right))

    @property
    def median_std_px(self) -> float:
        """Return the usual 1-sigma of a pick."""
        return float(np.median(self.std_px))


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
    """Return raw pixels of points (..., 3) of the camera's frame; NaN behind the camera."""
    z = points_m[..., 2:]
    return camera.distort(points_m[..., :2] / np.where(z > _NEAREST_M, z, np.nan))


@dataclass(frozen=True, eq=False)
class DriftPrior:
    """
    What is known beforehand of the extrinsic drift: how the right camera has rotated.

    :param mean_rad: (3,) pan, tilt and roll since the calibration.
    :param root: (n, 3) such that ``root @ (drift - mean_rad)`` has unit covariance.
    """

    mean_rad: Array
    root: Array

    @classmethod
    def loose(cls, std_rad: float) -> DriftPrior:
        """Return one about no drift at all."""
        return cls(np.zeros(3), np.eye(3) / std_rad)


def in_order(cost: Array) -> NDArray[np.intp]:
    """
    Return the column (g, n) of each row of least cost together, columns never going back.

    :param cost: (g, n, m) of each column for each row, for each of some groups.
    """
    groups, columns = np.arange(len(cost)), np.arange(cost.shape[2])
    total, came = cost[:, 0], []
    for row in range(1, cost.shape[1]):
        least = np.minimum.accumulate(total, axis=1)
        # the last column at or before each at which the least was reached
        came.append(np.maximum.accumulate(np.where(total == least, columns, 0), axis=1))
        total = least + cost[:, row]
    out = [np.argmin(total, axis=1)]
    for back in reversed(came):
        out.append(back[groups, out[-1]])
    return np.stack(out[::-1], axis=1).astype(np.intp)


class RoadProblem:
    """
    The residuals of a road model and their derivatives.

    :param rig: the calibrated rig.
    :param picks: of all lines.
    :param model: the family of roads.
    :param drift: what is known of the drift of the right camera, whose angles are then the last
        three unknowns. None: it stands as calibrated.
    :param prior: what is known of any road.
    :param wander: how lines may wander, whose numbers follow the other unknowns. None: they do
        not.
    """

    def __init__(self, rig: StereoRig, picks: Picks, model: RoadModel,
                 drift: Optional[DriftPrior] = None, prior: RoadPrior = RoadPrior(),
                 wander: Optional[Wander] = None) -> None:
        self.rig, self.picks, self.model = rig, picks, model
        self.drift, self.prior, self.wander = drift, prior, wander
        self.steps = model.steps if drift is None else np.append(
            model.steps, np.full(3, _DRIFT_STEP_RAD))
        self._last: Optional[tuple[Array, Feet]] = None
        self._known: Optional[tuple[Array, tuple[Array, Array]]] = None

    @property
    def size(self) -> int:
        """Return the number of unknowns of road and rig."""
        return len(self.steps)

    def _reference(self, x: Array) -> tuple[Array, Array]:
        """Return the reference line of the model; the last one is kept."""
        if self._known is None or not np.array_equal(self._known[0], x):
            self._known = x.copy(), self.model.reference(x)
        return self._known[1]

    def drift_rad(self, x: Array) -> Array:
        """Return pan, tilt and roll (..., 3) of the right camera; zeros where they are fixed."""
        if self.drift is None:
            return np.zeros(x.shape[:-1] + (3,))
        return x[..., -3:]

    def to_right(self, x: Array, points_m: Array) -> Array:
        """Return points (..., n, 3) in the frame of the right camera as it stands now."""
        right = self.rig.to_right(points_m)
        return right if self.drift is None else right @ drift_matrix(self.drift_rad(x))

    def at(self, x: Array, s_m: Array) -> Array:
        """Return the pixels (..., n, 2) of the lines at arc lengths (n,), one for each pick."""
        points, frames = self._reference(x)
        return self._seen(x, (points, frames[..., 1]), s_m)

    def _seen(self, x: Array, reference: tuple[Array, Array], s_m: Array) -> Array:
        """Return the pixels of a point on the line of each pick, in the view of the pick."""
        weights = Weights.at(self.model.s_m, s_m)
        points, left = (weights(values) for values in reference)
        points = points + self.model.offsets_at(x, self.picks.line, s_m)[..., None] * left
        uv_px, right = np.empty(points.shape[:-1] + (2,)), self.picks.right
        uv_px[..., ~right, :] = pixels(self.rig.left, points[..., ~right, :])
        uv_px[..., right, :] = pixels(
            self.rig.right, self.to_right(x, points[..., right, :]))
        return uv_px

    def feet(self, x: Array) -> Feet:
        """Return where each pick meets its projected line."""
        if self._last is not None and np.array_equal(self._last[0], x):
            return self._last[1]
        points, frames = self._reference(x)
        reference = points, frames[..., 1]
        nodes, h = self.model.s_m, _STEP_M
        s, reach = nodes[self._nearest_nodes(x, reference)], 3 * (nodes[1] - nodes[0])
        for _ in range(3):
            here, after = (self._seen(x, reference, s + d)
                           for d in (-h, h))
            tangent, off = (after - here) / (2 * h), self.picks.uv_px - (here + after) / 2
            step = np.sum(off * tangent, -1) / np.sum(tangent * tangent, -1)
            s = np.clip(s + np.nan_to_num(np.clip(step, -reach, reach)),
                        REACH * nodes[0], REACH * nodes[-1])
        length = np.linalg.norm(tangent, axis=-1, keepdims=True)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / length
        off = self.picks.uv_px - self._seen(x, reference, s)
        residual = np.sum(normal * off, axis=-1)
        lost = ~np.isfinite(residual)
        feet = Feet(s, np.where(lost[:, None], 0.0, normal), np.where(lost, _LOST_PX, residual))
        self._last = x.copy(), feet
        return feet

    def _nearest_nodes(self, x: Array, reference: tuple[Array, Array]) -> NDArray[np.intp]:
        """
        Return the node (n,) whose projection is nearest to each pick.

        The picks of a line are in order: where a hairpin or a crest brings a line back near
        itself in the image, the order tells which of its parts a pick is of.
        """
        nodes, lines = self.model.s_m, []
        for i in range(self.model.lines):
            offset = self.model.offsets_at(x, np.full(len(nodes), i), nodes)
            lines.append(reference[0] + offset[:, None] * reference[1])
        stack = np.array(lines)
        views = (pixels(self.rig.left, stack), pixels(self.rig.right, self.to_right(x, stack)))
        groups = [(i, right, np.flatnonzero(self.picks.of_line(i, right)))
                  for i in range(self.model.lines) for right in (False, True)]
        square = np.zeros((len(groups), max(len(mine) for _, _, mine in groups), len(nodes)))
        for group, (i, right, mine) in zip(square, groups):
            gap = self.picks.uv_px[mine, None] - views[int(right)][i]
            group[:len(mine)] = np.fmin(np.sum(gap * gap, axis=-1), _ASTRAY_PX**2)
        nearest = np.zeros(len(self.picks.line), dtype=np.intp)
        for (_, _, mine), columns in zip(groups, in_order(square)):
            nearest[mine] = columns[:len(mine)]
        return nearest

    @property
    def prior_std(self) -> Array:
        """Return the 1-sigmas of the parameters of the shape and of the tapers, beforehand."""
        shape, half, prior = self.model.shape, self.model.half_length_m, self.prior
        tilt = np.array([prior.grade_std_rad, prior.crossfall_std_rad])
        number = np.arange(1, max(shape) + 1)  # roads are smooth: further coefficients are smaller
        return np.concatenate([
            np.full(self.model.lines * self.model.tapered, max(prior.taper_std_m, _LEAST_TAPER_M)),
            prior.curvature_std_per_m * half / number[:shape.curvature], tilt[:shape.tilt],
            prior.crest_std_per_m * half / number[:shape.vertical],
            prior.twist_std_rad / number[:shape.twist],
            np.array([1.0, prior.vertical_curve_log_std, prior.crest_std_per_m * half]
                     )[:shape.vertical_curve],
            np.array([1.0, prior.run_off_log_std, prior.twist_std_rad, prior.run_off_axis_std_m]
                     )[:shape.run_off],
            np.array([1.0, prior.transition_log_std, prior.curvature_std_per_m * half]
                     )[:shape.transition]])

    @property
    def prior_mean(self) -> Array:
        """Return what the parameters of the shape and the tapers are beforehand."""
        places, out = self.model.places, np.zeros(self.model.size)
        prior = self.prior
        for place, usual_m in ((places.vertical_curve, prior.vertical_curve_m),
                               (places.run_off, prior.run_off_m),
                               (places.transition, prior.transition_m)):
            out[place][1:2] = np.log(usual_m / self.model.half_length_m)
        return out[places.tapers.start:]

    def priors(self, x: Array) -> Array:
        """
        Return weak constraints as (..., 1 and more) residuals in sigmas.

        They are roll, tapers, the coefficients of the shape, and the drift of the right camera.
        """
        axes = (self._reference(x)[1])[..., len(self.model.s_m) // 2, :, :]
        roll = axes[..., 1, 1:2]  # how far the left axis dips below the camera's horizontal
        weak = np.concatenate([
            roll / self.prior.roll_std_rad,
            (x[..., self.model.places.tapers.start:self.model.size] - self.prior_mean)
            / self.prior_std], axis=-1)
        if self.drift is None:
            return weak
        drift = (self.drift_rad(x) - self.drift.mean_rad) @ self.drift.root.T
        return np.concatenate([weak, drift], axis=-1)

    def rigid(self, x: Array) -> Array:
        """Return the residuals of lines that do not wander, in sigmas."""
        return np.append(self.feet(x).residual_px / self.picks.std_px, self.priors(x))

    def residuals(self, unknowns: Array) -> Array:
        """Return all residuals in sigmas, of (size,) unknowns and those of the ways to wander."""
        x, wander = unknowns[:self.size], unknowns[self.size:]
        rigid = self.rigid(x)
        if self.wander is None:
            return rigid
        rigid[:len(self.wander.off)] -= self.wander.off @ wander
        return np.append(rigid, wander)

    def jacobian(self, unknowns: Array) -> Array:
        """Return their derivatives; moving a foot along its line changes nothing, so feet stay."""
        x = unknowns[:self.size]
        feet, steps = self.feet(x), self.steps
        both = x + np.concatenate([np.diag(steps), -np.diag(steps)])
        uv = self.at(both, feet.s_m)
        moved = np.concatenate(
            [-np.sum(np.nan_to_num(uv) * feet.normal, axis=-1) / self.picks.std_px,
             self.priors(both)], axis=-1)
        slope = np.asarray(((moved[:len(steps)] - moved[len(steps):]) / (2 * steps[:, None])).T)
        return slope if self.wander is None else self._with_wander(slope, self.wander)

    @staticmethod
    def _with_wander(slope: Array, wander: Wander) -> Array:
        """Return derivatives by the numbers of the ways to wander beside those by the others."""
        (rows, columns), count = slope.shape, wander.count
        out = np.zeros((rows + count, columns + count))
        out[:rows, :columns] = slope
        out[:len(wander.off), columns:] = -wander.off
        out[rows:, columns:] = np.eye(count)
        return out
