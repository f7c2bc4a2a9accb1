# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The least-squares problem of a road: the distances of picks from their projected lines."""
from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Callable, Mapping, Optional, TypeVar

import numpy as np
from numpy.typing import NDArray

from .line_kernels import (feet_on_lines, LEAST_DEPTH_M, Lines, pixels_of_lines, plain_feet,
                           plain_pixels, RigViews)
from .model import drift_matrix, RoadModel, RoadShape
from .run_off import prior_std
from .wander import MayWander, Wander
from ..core.config import CheckedRecord, parameter
from ..core.records import Array
from ..geometry.camera import Camera
from ..geometry.rig import StereoRig

_Of = TypeVar('_Of')

_DRIFT_STEP_RAD = 1e-6  # step for finite differences, which moves the picks by about 1e-3 px
_LEAST_TAPER_M = 1e-6  # 1-sigma that stands for exactly parallel lines
_WANDERS = (1 / 3, 1.0, 3.0)  # 1-sigmas of wandering that are tried, as multiples of wander_std_m
_ALIKE = 0.5  # weight of the prior of how far lines wander, in lines already seen on this road


@dataclass(frozen=True)
class RoadPrior(CheckedRecord):
    """Prior knowledge of any road and rig."""

    pick_std_px: float = parameter(
        0.3, 0.01, 10.0, 'px', '1-sigma across the line of a carefully clicked point')
    best_pick_std_px: float = parameter(
        0.02, 0.0, 10.0, 'px', 'least scatter of the points of a line about a road')
    roll_std_rad: float = parameter(
        0.1, 1e-3, 3.0, 'rad', "1-sigma of the road's roll about its direction, relative to the "
        "camera's up, which a single straight line does not determine")
    grade_std_rad: float = parameter(
        0.06, 1e-4, 1.0, 'rad', '1-sigma of the grade of a curved road relative to its plane')
    crossfall_std_rad: float = parameter(
        0.04, 1e-4, 1.0, 'rad', '1-sigma of the crossfall of a curved road relative to its plane')
    curvature_std_per_m: float = parameter(
        0.02, 1e-5, 1.0, '1/m', '1-sigma of the curvature of a road that is not straight')
    crest_std_per_m: float = parameter(
        1 / 400, 1e-6, 1.0, '1/m', '1-sigma of the vertical curvature of a road whose grade '
        'changes; crests are built with radii from 200 m at 30 km/h to 5000 m at 100 km/h')
    twist_std_rad: float = parameter(
        0.04, 1e-4, 1.0, 'rad', '1-sigma of the change of the crossfall over half the road, if '
        'it changes; superelevation is built up to 8 %')
    vertical_curve_m: float = parameter(
        40.0, 1.0, 1000.0, 'm', 'usual length of a vertical curve, which joins two grades')
    vertical_curve_log_std: float = parameter(
        0.7, 0.01, 5.0, '', '1-sigma of the natural logarithm of that length')
    bent_probability: float = parameter(
        0.1, 1e-6, 0.9, '', 'prior probability of each further parameter of the shape of a road, '
        'and of a bend that lies in a plane; a clothoid is as common as an arc')
    taper_std_m: float = parameter(
        0.003, 0.0, 1.0, 'm', '1-sigma of how far a line diverges from the others over half of '
        'the road; this limits how well lines reveal a rotation of a camera')
    wander_std_m: float = parameter(
        0.003, 1e-6, 1.0, 'm', '1-sigma of the displacement of a line that wanders, which is '
        'correlated along the line; a third and three times of it are tried as well')
    wander_length_m: float = parameter(
        20.0, 0.1, 1000.0, 'm', 'correlation length of that displacement; better too long, as '
        'close picks hardly determine it')
    wander_probability: float = parameter(
        0.2, 0.0, 0.99, '', 'prior share of lines that wander; 0 for none')
    survey_std_m: float = parameter(
        0.03, 0.0, 10.0, 'm', '1-sigma of a given or surveyed point across its line, if the site '
        'does not give it; errors of neighbouring points are correlated')
    calibrated_std_deg: float = parameter(
        0.0003, 0.0, 1.0, 'degrees', '1-sigma of each angle between cameras that have not been '
        'touched since their calibration')

    @property
    def may_wander(self) -> MayWander:
        """Return the prior of how far lines wander."""
        chance = self.wander_probability
        if not chance:
            return MayWander((0.0,), (1.0,))
        return MayWander(
            (0.0, *(share * self.wander_std_m for share in _WANDERS)),
            (_ALIKE * (1 - chance), *[_ALIKE * chance / len(_WANDERS)] * len(_WANDERS)))

    @property
    def calibrated_covariance_rad2(self) -> Array:
        """Return the covariance (3, 3) of pan, tilt and roll of a calibrated rig, rad^2."""
        return np.asarray(np.radians(self.calibrated_std_deg) ** 2 * np.eye(3))


@dataclass(frozen=True, eq=False)
class Picks:
    """
    All picks of a road's lines.

    :param names: names of the lines, in the order of their numbers.
    :param uv_px: (n, 2) raw pixels.
    :param line: (n,) number of the line of each pick.
    :param right: (n,) whether the pick is in the right view.
    :param std_px: (n,) 1-sigma across the line, px.
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

        :param lines: maps names to raw pixels (left (n, 2), right (m, 2)).
        :param std_px: maps names to 1-sigmas (left (n,), right (m,)), px.
        :param click_std_px: 1-sigma of the picks of lines not in ``std_px``, px.
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
        Return which picks (n,) belong to a line in one view.

        :param line: number of the line.
        :param right: whether the view is the right one.
        """
        return np.asarray((self.line == line) & (self.right == right))

    @property
    def median_std_px(self) -> float:
        """Return the median 1-sigma of the picks, px."""
        return float(np.median(self.std_px))

    def are_precise(self, prior: RoadPrior) -> bool:
        """Return whether they are more precise than clicks."""
        return self.median_std_px < prior.pick_std_px


@dataclass(frozen=True, eq=False)
class Feet:
    """
    The feet of the picks: the nearest points of their projected lines.

    :param s_m: (n,) reference arc length of each foot, m.
    :param normal: (n, 2) unit normal of the projected line there.
    :param residual_px: (n,) signed distance of the pick from the projected line, px.
    """

    s_m: Array
    normal: Array
    residual_px: Array


def pixels(camera: Camera, points_m: Array) -> Array:
    """Return raw pixels of points (..., 3) in the camera's frame; NaN behind the camera."""
    z = points_m[..., 2:]
    return camera.distort(points_m[..., :2] / np.where(z > LEAST_DEPTH_M, z, np.nan))


@dataclass(frozen=True, eq=False)
class DriftPrior:
    """
    Prior of the extrinsic drift, the rotation of the right camera.

    :param mean_rad: (3,) pan, tilt and roll since the calibration, rad.
    :param root: (n, 3) square root of the information: ``root @ (drift - mean_rad)`` has unit
        covariance.
    """

    mean_rad: Array
    root: Array

    @classmethod
    def loose(cls, std_rad: float) -> DriftPrior:
        """Return a prior about no drift, with the same 1-sigma for each angle."""
        return cls(np.zeros(3), np.eye(3) / std_rad)


class RoadProblem:
    """
    The residuals of a road model and their derivatives.

    :param rig: the calibrated rig.
    :param picks: picks of all lines.
    :param model: the family of roads.
    :param drift: prior of the drift of the right camera, whose angles are then the last three
        unknowns of road and rig. None means that it stands as calibrated.
    :param prior: prior knowledge of any road.
    :param wander: how lines may wander; its coefficients follow the other unknowns. None means
        that they do not wander.
    :raises ValueError: a pick is of a line that the model does not have.
    """

    def __init__(self, rig: StereoRig, picks: Picks, model: RoadModel,
                 drift: Optional[DriftPrior] = None, prior: RoadPrior = RoadPrior(),
                 wander: Optional[Wander] = None) -> None:
        if len(picks.line) and not 0 <= picks.line.min() <= picks.line.max() < model.lines:
            raise ValueError(f'picks of lines {picks.line.min()} to {picks.line.max()}, '
                             f'the model has {model.lines}')  # kernels do not check their indices
        self.rig, self.picks, self.model = rig, picks, model
        self.drift, self.prior, self.wander = drift, prior, wander
        self.steps = model.steps if drift is None else np.append(
            model.steps, np.full(3, _DRIFT_STEP_RAD))
        self._calibrated_views = RigViews.of(rig)  # None for lenses unknown to kernels
        self._last: Optional[tuple[Array, Feet]] = None
        self._known: Optional[tuple[Array, tuple[Array, Array]]] = None

    @property
    def size(self) -> int:
        """Return the number of unknowns of road and rig."""
        return len(self.steps)

    def _reference(self, many: Array) -> tuple[Array, Array]:
        """Return the reference lines of roads (k, size); the last result is cached."""
        if self._known is None or not np.array_equal(self._known[0], many):
            self._known = many.copy(), self.model.reference(many)
        return self._known[1]

    def drift_rad(self, x: Array) -> Array:
        """Return pan, tilt and roll (..., 3) of the right camera, rad; zeros if they are fixed."""
        if self.drift is None:
            return np.zeros(x.shape[:-1] + (3,))
        return x[..., -3:]

    def to_right(self, x: Array, points_m: Array) -> Array:
        """Return points (..., n, 3) in the frame of the right camera, with the drift applied."""
        right = self.rig.to_right(points_m)
        return right if self.drift is None else right @ drift_matrix(self.drift_rad(x))

    def _see(self, many: Array, points_m: Array, right: bool) -> Array:
        """Return raw pixels of points (k, n, 3) in one view of rigs (k, size)."""
        if not right:
            return pixels(self.rig.left, points_m)
        return pixels(self.rig.right, self.to_right(many, points_m))

    def _of_picks(self, kernel: Callable[..., _Of], plain: Callable[..., _Of], many: Array,
                  values: Array) -> _Of:
        """
        Return the result of a kernel for the lines of the picks, seen by rigs (k, size).

        :param plain: its equivalent for lenses that kernels do not support.
        :param values: a value for each pick.
        """
        picks, lines = self.picks, Lines.of(self.model, many, self._reference(many))
        if self._calibrated_views is None:
            return plain(picks.line, picks.right, values, lines, partial(self._see, many))
        views = self._calibrated_views.drifted(drift_matrix(self.drift_rad(many)))
        return kernel(picks.line, picks.right, values, *lines, *views)

    def at(self, x: Array, s_m: Array) -> Array:
        """
        Return the pixels of each pick's line at the arc length (n,) of the pick.

        :param x: (size,) unknowns, or (k, size).
        :return: (n, 2), or (k, n, 2).
        """
        uv_px = self._of_picks(pixels_of_lines, plain_pixels, np.atleast_2d(x), s_m)
        return np.asarray(uv_px.reshape(x.shape[:-1] + uv_px.shape[1:]))

    def feet(self, x: Array) -> Feet:
        """Return the foot of each pick on its projected line."""
        if self._last is not None and np.array_equal(self._last[0], x):
            return self._last[1]
        feet = Feet(*self._of_picks(feet_on_lines, plain_feet, x[None], self.picks.uv_px))
        self._last = x.copy(), feet
        return feet

    @property
    def prior_std(self) -> Array:
        """Return the prior 1-sigmas of the tapers and of the parameters of the shape."""
        shape, half, prior = self.model.shape, self.model.half_length_m, self.prior
        tilt = np.array([prior.grade_std_rad, prior.crossfall_std_rad])
        number = np.arange(1, max(shape) + 1)  # roads are smooth: higher coefficients are smaller
        return np.concatenate([
            np.full(self.model.lines * self.model.tapered, max(prior.taper_std_m, _LEAST_TAPER_M)),
            prior.curvature_std_per_m * half / number[:shape.curvature], tilt[:shape.tilt],
            prior.crest_std_per_m * half / number[:shape.vertical],
            prior.twist_std_rad / number[:shape.twist],
            np.array([1.0, prior.vertical_curve_log_std, prior.crest_std_per_m * half]
                     )[:shape.vertical_curve],
            prior_std(prior.curvature_std_per_m * half, prior.twist_std_rad)[:shape.run_off]])

    def changes(self, shape: RoadShape) -> slice:
        """
        Return the places of coefficients by which the curvature changes by an unknown scale.

        There are none if the picks are no more precise than clicks, which cannot show slight
        changes.  The scales count where families are compared; a fit itself has the largest one.

        :param shape: a family whose curvature has no more coefficients than that of the model.
        """
        first = self.model.places.curvature.start + 1
        count = max(shape.curvature - 1, 0) * self.picks.are_precise(self.prior)
        return slice(first, first + count)

    def change_std(self, changes: slice) -> Array:
        """Return the largest prior 1-sigmas of such coefficients."""
        first = self.model.places.tapers.start
        return self.prior_std[changes.start - first:changes.stop - first]

    @property
    def prior_mean(self) -> Array:
        """Return the prior means of the tapers and of the parameters of the shape."""
        places, out = self.model.places, np.zeros(self.model.size)
        out[places.vertical_curve][1:2] = np.log(
            self.prior.vertical_curve_m / self.model.half_length_m)
        return out[places.tapers.start:]

    def priors(self, x: Array) -> Array:
        """
        Return the residuals (..., m) of the priors, in sigmas.

        They are those of roll, tapers, the parameters of the shape, and the right camera's drift.
        """
        frames = self._reference(np.atleast_2d(x))[1][:, len(self.model.s_m) // 2]
        roll = frames[:, 1, 1]  # dip of the left axis below the camera's horizontal
        weak = np.concatenate([
            roll.reshape(x.shape[:-1] + (1,)) / self.prior.roll_std_rad,
            (x[..., self.model.places.tapers.start:self.model.size] - self.prior_mean)
            / self.prior_std], axis=-1)
        if self.drift is None:
            return weak
        drift = (self.drift_rad(x) - self.drift.mean_rad) @ self.drift.root.T
        return np.concatenate([weak, drift], axis=-1)

    def rigid(self, x: Array) -> Array:
        """Return the residuals for lines that do not wander, in sigmas."""
        return np.append(self.feet(x).residual_px / self.picks.std_px, self.priors(x))

    def residuals(self, unknowns: Array) -> Array:
        """Return all residuals, in sigmas, given the unknowns of road, rig and wandering."""
        x, wander = unknowns[:self.size], unknowns[self.size:]
        rigid = self.rigid(x)
        if self.wander is None:
            return rigid
        rigid[:len(self.wander.off)] -= self.wander.off @ wander
        return np.append(rigid, wander)

    def jacobian(self, unknowns: Array) -> Array:
        """Return the derivatives of the residuals; a foot's shift along its line has no effect."""
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
        """Return the derivatives with those by the coefficients of wandering appended."""
        (rows, columns), count = slope.shape, wander.count
        out = np.zeros((rows + count, columns + count))
        out[:rows, :columns] = slope
        out[:len(wander.off), columns:] = -wander.off
        out[rows:, columns:] = np.eye(count)
        return out
