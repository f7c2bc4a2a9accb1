# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The paths of lanes, midway between two lines of a fitted road or between surveyed lines."""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Optional, Sequence

import numpy as np

from .fitted import RoadFit
from .model import NODES, Weights
from .path import chord_lengths, Path, SplinePath, StraightPath
from .path_effect import path_effect, PLACES, seen_stretch
from .spline_kernels import unit
from ..core.records import Array
from ..geometry.rig import StereoRig

_SLIDE_M = 0.5  # step along the path from which the curvature in its middle is computed
# A rival is sampled at so many places, up to so many times as far as its last nodes.
_BEYOND, _DENSE = 1.2, 4001
# Spacing and smallest number of the points of a path between surveyed lines.
_SPACING_M, _FEWEST = 1.0, 8


@dataclass(frozen=True, eq=False)
class LanePath:
    """
    The path of a lane and its uncertainty.

    :param name: name of the lane.
    :param path: path in the direction of travel.
    :param speed_limit_mps: speed limit, m/s; None if the site file gives none.
    :param heading_std_rad: (2,) 1-sigma of the direction in the middle, across (P) and up (B),
        rad.
    :param residual_px: r.m.s. distance of the picks from the lines, px; 0 for surveyed lines.
    :param scale_std: relative 1-sigma of the speed of a pass over the whole path by errors of
        lengths along it, with near observations weighing most.
    :param scale_profile: arc lengths (n,) in m and the relative 1-sigma (n,) of lengths there.
        The errors along the path are fully correlated and grow with distance.  None means
        ``scale_std`` everywhere.
    :param shape_std: relative 1-sigma of speeds by errors of the path other than its direction.
    """

    name: str
    path: Path
    speed_limit_mps: Optional[float]
    heading_std_rad: Array
    residual_px: float
    scale_std: float = 0.0
    scale_profile: Optional[tuple[Array, Array]] = None
    shape_std: float = 0.0

    def with_heading_std(self, std_rad: Array) -> LanePath:
        """
        Return the lane with a further, independent uncertainty of its direction.

        :param std_rad: (2,) its 1-sigma across and up, rad.
        """
        return replace(self, heading_std_rad=np.hypot(self.heading_std_rad, std_rad))

    def heading_std_by(self, covariance_rad2: Array) -> Array:
        """
        Return the 1-sigma (2,) of the direction, across and up, after an uncertain rotation, rad.

        :param covariance_rad2: (3, 3) covariance of its rotation vector, rad^2.
        """
        _, across, up = self.path.frame(np.array(self.path.length_m / 2)).T
        # It turns across about the axis up, and up about the axis across.
        return np.sqrt([axis @ covariance_rad2 @ axis for axis in (up, across)])

    def scale_std_at(self, s_m: Array) -> Array:
        """
        Return the relative 1-sigma of lengths along the path at arc lengths (...,).

        The errors at different places are fully correlated and do not average out.
        """
        s_m = np.asarray(s_m, dtype=np.float64)
        if self.scale_profile is None:
            return np.full(s_m.shape, self.scale_std)
        return np.interp(s_m, *self.scale_profile)


def lane_of_road(name: str, fit: RoadFit, lines: tuple[int, ...],
                 speed_limit_mps: Optional[float], *, reverse: bool = False) -> LanePath:
    """
    Return a lane's path midway between its lines, or along its only line.

    The path extends from the first to the last pick of these lines.

    :param fit: the road.
    :param lines: numbers of the lane's lines in the fit, one or two.
    :param reverse: whether travel runs against the order of the picks in the fit.
    """
    ranges = np.array([fit.line_range_m(i) for i in lines])
    s = np.linspace(ranges[:, 0].min(), ranges[:, 1].max(), NODES)
    points, frames = _lane(fit, fit.x, lines, s[::-1] if reverse else s)
    if not any(fit.problem.model.shape):
        path: Path = StraightPath(
            points[0], points[-1] - points[0], s[-1] - s[0], frames[0, :, 2])
    else:
        path = SplinePath(points, frames[:, :, 2])
    square = np.mean(fit.residual_px[list(lines)]**2)
    heading_std, shape_std = _uncertain(fit, lines, s)
    return LanePath(name, path, speed_limit_mps, heading_std, float(np.sqrt(square)),
                    shape_std=shape_std)


def _lane(fit: RoadFit, x: Array, lines: tuple[int, ...], s_m: Array) -> tuple[Array, Array]:
    """Return a lane's points (..., n, 3) and frames (..., n, 3, 3) at reference arc lengths."""
    model = fit.problem.model
    points, frames = model.reference(x)
    offset = model.offsets(x)[..., list(lines)].mean(axis=-1)[..., None, None]
    weights = Weights.at(model.s_m, s_m)
    axes = np.stack([weights(frames[..., i]) for i in range(3)], axis=-1)
    return weights(points) + offset * axes[..., 1], axes


def _uncertain(fit: RoadFit, lines: tuple[int, ...], s_m: Array) -> tuple[Array, float]:
    """
    Return the uncertainty of a lane's path.

    The rivals of the road contribute their disagreement, weighted by their probabilities.

    :param s_m: (n,) reference arc lengths along the lane, m.
    :return: the 1-sigmas (2,) of the direction in the middle, across and up, rad, and the relative
        1-sigma of speeds by other errors of the path.
    """
    weight = np.array([odds for odds, _ in fit.rivals])
    weight = weight / (1 + weight.sum())
    variance = _heading_variance(fit, lines, s_m[NODES // 2])
    middle, axes = (values[0] for values in _lane(fit, fit.x, lines, s_m[[NODES // 2]]))
    others = [_densely(rival, lines) for _, rival in fit.rivals]
    for share, (points, tangents) in zip(weight, others):
        near = int(np.argmin(np.linalg.norm(points - middle, axis=-1)))
        variance = variance + share * (tangents[near] @ axes[:, 1:])**2
    return np.sqrt(variance), _shape_std(fit, lines, s_m, variance, list(zip(weight, others)))


def _densely(fit: RoadFit, lines: tuple[int, ...]) -> tuple[Array, Array]:
    """Return closely spaced points (n, 3) of a lane, and its directions (n, 3) there."""
    nodes = fit.problem.model.s_m
    points, axes = _lane(fit, fit.x, lines, np.linspace(
        _BEYOND * nodes[0], _BEYOND * nodes[-1], _DENSE))
    return points, axes[..., 0]


def _heading_variance(fit: RoadFit, lines: tuple[int, ...], middle_m: float) -> Array:
    """
    Return the variances (2,) of a lane's direction in its middle, across and up, rad^2.

    A point that slides along the path by ds changes its direction from ``T(s)`` to ``T(s + ds)``.
    This is not an error of the path, and is subtracted.
    """
    steps, h = fit.problem.steps, _SLIDE_M
    both = fit.x + np.concatenate([np.diag(steps), -np.diag(steps)])
    points, frames = _lane(fit, both, lines, np.array([middle_m]))
    near, axes = _lane(fit, fit.x, lines, middle_m + np.array([-h, 0.0, h]))
    curvature = (axes[2] - axes[0])[:, 0] / np.linalg.norm(near[2] - near[0])

    def slope(values: Array) -> Array:
        return (values[:len(steps)] - values[len(steps):]) / (2 * steps[:, None])

    position, direction = slope(points[:, 0]), slope(frames[:, 0, :, 0])
    direction = direction - np.outer(position @ axes[1][:, 0], curvature)
    direction = direction @ axes[1][:, 1:]
    return np.asarray(np.einsum('ij,ik,kj->j', direction, fit.covariance, direction))


def _shape_std(fit: RoadFit, lines: tuple[int, ...], s_m: Array, heading_variance: Array,
               rivals: list[tuple[float, tuple[Array, Array]]]) -> float:
    """
    Return the relative 1-sigma of speeds by errors of the path other than its direction.

    :param heading_variance: (2,) variances of the direction, rad^2, which is left out because
        each pass solves for it.
    :param rivals: weight, and points and directions of the lane, of each rival road.
    """
    rig, points = fit.problem.rig, _lane(fit, fit.x, lines, s_m)[0]
    stretch = seen_stretch(rig, points)
    if stretch is None:
        return 0.0
    s = s_m[0] + (s_m[-1] - s_m[0]) * np.linspace(*stretch, PLACES)
    points, axes = _lane(fit, fit.x, lines, s)
    effect = path_effect(rig, points, axes, chord_lengths(points))
    steps = fit.problem.steps
    both = _lane(fit, fit.x + np.concatenate([np.diag(steps), -np.diag(steps)]), lines, s)[0]
    arcs = np.concatenate([np.zeros(both.shape[:1] + (1,)), np.cumsum(
        np.linalg.norm(np.diff(both, axis=1), axis=-1), axis=1)], axis=1)
    moved, longer = ((v[:len(steps)] - v[len(steps):]) / 2 for v in (both, arcs))
    slope = effect.speed(moved, longer) / steps
    variance = float(slope @ fit.covariance @ slope)
    middle = points[PLACES // 2]
    for axis, turn in ((2, heading_variance[0]), (1, heading_variance[1])):
        rotated = np.cross(axes[PLACES // 2, :, axis], points - middle)
        variance -= turn * float(effect.speed(rotated, np.zeros(PLACES)))**2
    for weight, (others, _) in rivals:
        near = [int(np.argmin(np.linalg.norm(others - p, axis=-1))) for p in points]
        variance += weight * float(effect.speed(
            others[near] - points, chord_lengths(others)[near] - chord_lengths(points)))**2
    return float(np.sqrt(max(variance, 0.0)))


def between(right: Path, left: Path) -> SplinePath:
    """
    Return a path midway between two lines of any kind; its up axis is perpendicular to both.

    :param right: the line on the driver's right.
    :param left: the line on the driver's left.
    """
    s = np.linspace(0.0, right.length_m, max(_FEWEST, int(np.ceil(right.length_m / _SPACING_M))))
    on_right = right.position(s)
    s_left = left.arc_length(on_right)
    on_left = left.position(s_left)
    tangent = unit(right.tangent(s) + left.tangent(s_left))
    up = np.cross(tangent, unit(on_left - on_right))
    return SplinePath((on_right + on_left) / 2, up)


def lane_of_paths(name: str, paths: tuple[Path, ...], speed_limit_mps: Optional[float],
                  rig: StereoRig, std_m: float, fitted: Sequence[LanePath] = ()) -> LanePath:
    """
    Return a lane of which at least one line is surveyed.

    Errors of the points that vary along the path rotate and bow it.  Midway between two lines,
    those of a fitted one count by half; those of a survey count whole, as both lines may share
    them.

    :param paths: one path, or those of the right and the left line.
    :param rig: rig that sees the lane.
    :param std_m: 1-sigma of the surveyed points across the path, m.
    :param fitted: those of the paths that are fitted to picks.
    """
    path = paths[0] if len(paths) == 1 else between(*paths)
    # The errors of the two ends are independent.
    lane = LanePath(name, path, speed_limit_mps, np.full(2, np.sqrt(2.0) * std_m / path.length_m),
                    max((line.residual_px for line in fitted), default=0.0),
                    shape_std=std_m * _bow_effect(path, rig))
    for line in fitted:
        lane = replace(lane.with_heading_std(line.heading_std_rad / len(paths)),
                       shape_std=math.hypot(lane.shape_std, line.shape_std / len(paths)))
    return lane


def _bow_effect(path: Path, rig: StereoRig) -> float:
    """Return the relative change of speeds per m by which a path's middle bows."""
    # A surveyed line may go on far beyond the view.
    s = np.linspace(0.0, path.length_m, max(NODES, math.ceil(path.length_m / _SPACING_M)))
    stretch = seen_stretch(rig, path.position(s))
    if stretch is None:
        return 0.0
    s = path.length_m * np.linspace(*stretch, PLACES)
    points, frames = path.position(s), path.frame(s)
    effect = path_effect(rig, points, frames, s)
    bow = 1 - (2 * s / path.length_m - 1)**2
    return float(np.hypot(*(effect.speed(bow[:, None] * frames[..., axis], np.zeros(PLACES))
                            for axis in (1, 2))))
