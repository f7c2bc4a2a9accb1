# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Lines of a road in both views, and the feet of picks on them: the kernels of ``RoadProblem``.

The fit of a road asks for a few hundred pixels at a time, but so often that the overhead of
numpy's calls dominates.
"""
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .model import Weights
from ..core.compiled import inlined, Kernel, kernel
from ..core.records import Array
from ..geometry.projection import distorted, plain_distorted, Projection
from ..geometry.rig import StereoRig

REACH = 1.3  # distance from the middle, in half lengths, up to which feet are searched
NEAREST_M = 0.1  # least depth of a visible point
_STEP_M = 0.01  # step along a line for its direction in the image
_LOST_PX = 1e3  # residual of a pick whose line is behind the camera; its derivative is 0
_ASTRAY_PX = 60.0  # cap of the distance by which a pick is assigned to a part of its line
_FAR_NODES = 3  # most nodes by which a step of Newton's method moves a foot
_STEPS = 3  # steps of Newton's method to a foot


class Lines(NamedTuple):
    """
    Lines beside ``k`` reference lines, in the form that the kernels take.

    :param points_m: (k, nodes, 3) points of the reference lines, left optical frame, m.
    :param left: (k, nodes, 3) unit directions to the left there.
    :param first_m: arc length of the first node, m.
    :param step_m: arc length between nodes, m.
    :param offset_m: (k, lines) distance of each line from its reference line in the middle, m,
        positive to the left.
    :param taper: (k, lines) change of that distance for each metre along the road.
    """

    points_m: Array
    left: Array
    first_m: float
    step_m: float
    offset_m: Array
    taper: Array

    @property
    def nodes_m(self) -> Array:
        """Return the arc lengths of the nodes, m."""
        return np.asarray(self.first_m + self.step_m * np.arange(self.points_m.shape[1]),
                          dtype=np.float64)


class Views(NamedTuple):
    """
    Left and right camera, in this order, in the form that the kernels take.

    :param kind: (2,) kinds of their lenses, see :class:`..geometry.projection.Projection`.
    :param coefficients: (2, 14) coefficients of their lenses.
    :param focal: (2, 3) fx, fy and skew, px.
    :param centre: (2, 2) principal points, px.
    :param rotation: (k, 2, 3, 3) rotations from the left camera's frame to theirs.
    :param offset_m: (k, 2, 3) origin of the left camera's frame in theirs, m.
    """

    kind: NDArray[np.int64]
    coefficients: Array
    focal: Array
    centre: Array
    rotation: Array
    offset_m: Array

    @classmethod
    def of(cls, rig: StereoRig) -> Views:
        """Return the views of a rig that has not drifted."""
        cameras = [Projection.of(c.lens, c.K, (c.width_px, c.height_px), None)
                   for c in (rig.left, rig.right)]
        kind, coefficients, _, focal, centre, *_ = zip(*cameras)
        return cls(np.array(kind, dtype=np.int64), np.array(coefficients), np.array(focal),
                   np.array(centre), np.stack([np.eye(3), rig.R])[None],
                   np.stack([np.zeros(3), rig.t])[None])

    def drifted(self, drift: Array) -> Views:
        """
        Return the views of ``k`` rigs whose right cameras have rotated.

        :param drift: (k, 3, 3) matrices that transform row vectors to the rotated frames.
        """
        rotation, offset_m = (np.repeat(a, len(drift), axis=0)
                              for a in (self.rotation, self.offset_m))
        turn = np.swapaxes(drift, -1, -2)
        rotation[:, 1] = turn @ rotation[:, 1]
        offset_m[:, 1] = (turn @ offset_m[:, 1, :, None])[..., 0]
        return self._replace(rotation=rotation, offset_m=offset_m)

    def chosen(self, one: Kernel[..., Any]) -> Any:
        """Return a kernel, or its plain function if kernels do not support a lens."""
        return one if Projection.supports(self.kind) else one.plain


def in_order(cost: Array) -> NDArray[np.intp]:
    """
    Return the non-decreasing column (g, n) of each row whose total cost is least.

    :param cost: (g, n, m) cost of each column for each row, in each group.
    """
    groups, columns = np.arange(len(cost)), np.arange(cost.shape[2])
    total, came = cost[:, 0], []
    for row in range(1, cost.shape[1]):
        least = np.minimum.accumulate(total, axis=1)
        # For each column, the last one up to it at which the running minimum was reached.
        came.append(np.maximum.accumulate(np.where(total == least, columns, 0), axis=1))
        total = least + cost[:, row]
    out = [np.argmin(total, axis=1)]
    for back in reversed(came):
        out.append(back[groups, out[-1]])
    return np.stack(out[::-1], axis=1).astype(np.intp)


def _in_views(points_m: Array, right: NDArray[np.bool_], views: Views) -> Array:
    """Return the pixels (k, n, 2) of points (k, n, 3), each in its view; NaN behind the camera."""
    uv_px = np.empty(points_m.shape[:-1] + (2,))
    for i, mine in enumerate((~right, right)):
        here = (points_m[..., mine, :] @ np.swapaxes(views.rotation[:, i], -1, -2)
                + views.offset_m[:, None, i])
        z = here[..., 2:]
        xy = plain_distorted(here[..., :2] / np.where(z > NEAREST_M, z, np.nan),
                             int(views.kind[i]), views.coefficients[i])
        fx, fy, skew = views.focal[i]
        uv_px[..., mine, 0] = fx * xy[..., 0] + skew * xy[..., 1]
        uv_px[..., mine, 1] = fy * xy[..., 1]
        uv_px[..., mine, :] += views.centre[i]
    return uv_px


def _plain_pixels(line: NDArray[np.int64], right: NDArray[np.bool_], s_m: Array, *of: Any
                  ) -> Array:
    """
    Return the pixels (k, n, 2) of points of lines; NaN behind the camera.

    :param line: (n,) number of the line of each point.
    :param right: (n,) whether to project it into the right view.
    :param s_m: (n,) arc lengths, m.
    :param of: parts of :class:`Lines` and :class:`Views`.
    """
    lines, views = Lines(*of[:len(Lines._fields)]), Views(*of[len(Lines._fields):])
    weights = Weights.at(lines.nodes_m, s_m)
    beside = lines.offset_m[:, line] + lines.taper[:, line] * s_m
    return _in_views(weights(lines.points_m) + beside[..., None] * weights(lines.left),
                     right, views)


def _plain_feet(line: NDArray[np.int64], right: NDArray[np.bool_], uv_px: Array, *of: Any
                ) -> tuple[Array, Array, Array]:
    """
    Return arc lengths (n,), m, normals (n, 2) and residuals (n,), px, of the feet of picks.

    A foot is the nearest point of the projected line, see :class:`.problem.Feet`.

    :param line: (n,) number of the line of each pick.
    :param right: (n,) whether it is in the right view.
    :param uv_px: (n, 2) raw pixels.
    :param of: parts of :class:`Lines` and :class:`Views`, both with ``k`` = 1.
    """
    lines, h = Lines(*of[:len(Lines._fields)]), _STEP_M
    nodes, half = lines.nodes_m, _FAR_NODES * lines.step_m
    s = nodes[_nearest_nodes(line, right, uv_px, lines, Views(*of[len(Lines._fields):]))]
    for _ in range(_STEPS):
        here, after = (_plain_pixels(line, right, s + d, *of)[0] for d in (-h, h))
        tangent, off = (after - here) / (2 * h), uv_px - (here + after) / 2
        step = np.sum(off * tangent, -1) / np.sum(tangent * tangent, -1)
        s = np.clip(s + np.nan_to_num(np.clip(step, -half, half)),
                    REACH * nodes[0], REACH * nodes[-1])
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / np.linalg.norm(
        tangent, axis=-1, keepdims=True)
    residual = np.sum(normal * (uv_px - _plain_pixels(line, right, s, *of)[0]), axis=-1)
    lost = ~np.isfinite(residual)
    return s, np.where(lost[:, None], 0.0, normal), np.where(lost, _LOST_PX, residual)


def _nearest_nodes(line: NDArray[np.int64], right: NDArray[np.bool_], uv_px: Array,
                   lines: Lines, views: Views) -> NDArray[np.intp]:
    """
    Return the node (n,) whose projection is nearest to each pick.

    The picks of a line are in order. If a hairpin or a crest brings the line back near itself in
    the image, the order determines which part of it a pick belongs to.
    """
    nodes, count = lines.nodes_m, lines.offset_m.shape[1]
    groups = [(i, side, np.flatnonzero((line == i) & (right == side)))
              for i in range(count) for side in (False, True)]
    square = np.zeros((len(groups), max(len(mine) for _, _, mine in groups), len(nodes)))
    for group, (i, side, mine) in zip(square, groups):
        beside = (lines.offset_m[0, i] + lines.taper[0, i] * nodes)[:, None]
        seen = _in_views(lines.points_m + beside * lines.left,
                         np.full(len(nodes), side), views)[0]
        gap = uv_px[mine, None] - seen
        group[:len(mine)] = np.fmin(np.sum(gap * gap, axis=-1), _ASTRAY_PX**2)
    nearest = np.zeros(len(line), dtype=np.intp)
    for (_, _, mine), columns in zip(groups, in_order(square)):
        nearest[mine] = columns[:len(mine)]
    return nearest


@inlined
def _seen(x, y, z, kind, k, focal, centre, turn, shift):  # type: ignore
    """Return the pixel of a point in a view; NaN behind the camera."""
    depth = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift[2]
    if not depth > NEAREST_M:
        depth = np.nan
    a, b = distorted((turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift[0]) / depth,
                     (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift[1]) / depth,
                     kind, k)
    return focal[0] * a + focal[2] * b + centre[0], focal[1] * b + centre[1]


@inlined
def _at(points, left, first, step, offset, taper, s, kind, k, focal, centre, turn, shift):  # type: ignore  # noqa: E501
    """Return the pixel of a line at an arc length, by cubic interpolation between nodes."""
    u = (s - first) / step
    i = min(max(int(np.floor(u)) - 1, 0), len(points) - 4)
    t, beside = u - i, offset + taper * s
    a, b = -(t - 1) * (t - 2) * (t - 3) / 6, t * (t - 2) * (t - 3) / 2
    c, d = -t * (t - 1) * (t - 3) / 2, t * (t - 1) * (t - 2) / 6
    x = (a * points[i, 0] + b * points[i + 1, 0] + c * points[i + 2, 0] + d * points[i + 3, 0]
         + beside * (a * left[i, 0] + b * left[i + 1, 0] + c * left[i + 2, 0]
                     + d * left[i + 3, 0]))
    y = (a * points[i, 1] + b * points[i + 1, 1] + c * points[i + 2, 1] + d * points[i + 3, 1]
         + beside * (a * left[i, 1] + b * left[i + 1, 1] + c * left[i + 2, 1]
                     + d * left[i + 3, 1]))
    z = (a * points[i, 2] + b * points[i + 1, 2] + c * points[i + 2, 2] + d * points[i + 3, 2]
         + beside * (a * left[i, 2] + b * left[i + 1, 2] + c * left[i + 2, 2]
                     + d * left[i + 3, 2]))
    return _seen(x, y, z, kind, k, focal, centre, turn, shift)


@inlined
def _nearest(line, right, uv_px, points, left, first, step, offset, taper, kind, k, focal, centre, turn, shift):  # type: ignore  # noqa: E501
    """Return what :func:`_nearest_nodes` returns; the least total cost by dynamic programming."""
    count, nodes = len(line), len(points)
    nearest, mine = np.zeros(count, np.int64), np.empty(count, np.int64)
    seen, total = np.empty((nodes, 2)), np.empty(nodes)
    came = np.empty((count, nodes), np.int64)  # node of the pick before, for each node of a pick
    for group in range(2 * len(offset)):
        number, view, row = group // 2, group % 2, 0
        for n in range(nodes):
            beside = offset[number] + taper[number] * (first + n * step)
            seen[n, 0], seen[n, 1] = _seen(
                points[n, 0] + beside * left[n, 0], points[n, 1] + beside * left[n, 1],
                points[n, 2] + beside * left[n, 2], kind[view], k[view], focal[view],
                centre[view], turn[view], shift[view])
        total[:] = 0.0
        for i in range(count):
            if line[i] != number or int(right[i]) != view:
                continue
            least, at = np.inf, 0
            for n in range(nodes):
                if total[n] <= least:
                    least, at = total[n], n
                came[row, n] = at
                gap = (uv_px[i, 0] - seen[n, 0])**2 + (uv_px[i, 1] - seen[n, 1])**2
                total[n] = least + (gap if gap < _ASTRAY_PX**2 else _ASTRAY_PX**2)
            mine[row] = i
            row += 1
        node = np.argmin(total)
        for back in range(row - 1, -1, -1):
            nearest[mine[back]] = node
            node = came[back, node]
    return nearest


_OF = ('f8[:,:,::1], f8[:,:,::1], f8, f8, f8[:,::1], f8[:,::1], i8[::1], f8[:,::1], f8[:,::1], '
       'f8[:,::1], f8[:,:,:,::1], f8[:,:,::1]')


@kernel(_plain_pixels, f'(i8[::1], b1[::1], f8[::1], {_OF})')
def pixels_of_lines(line: Any, right: Any, s_m: Any, points: Any, left: Any, first: float,
                    step: float, offset: Any, taper: Any, kind: Any, k: Any, focal: Any,
                    centre: Any, turn: Any, shift: Any) -> Any:
    """Return what :func:`_plain_pixels` returns."""
    out = np.empty((len(points), len(s_m), 2))
    for j in range(len(points)):
        for i in range(len(s_m)):
            number, view = line[i], int(right[i])
            out[j, i, 0], out[j, i, 1] = _at(
                points[j], left[j], first, step, offset[j, number], taper[j, number], s_m[i],
                kind[view], k[view], focal[view], centre[view], turn[j, view], shift[j, view])
    return out


@kernel(_plain_feet, f'(i8[::1], b1[::1], f8[:,::1], {_OF})')
def feet_on_lines(line: Any, right: Any, uv_px: Any, points: Any, left: Any, first: float,
                  step: float, offset: Any, taper: Any, kind: Any, k: Any, focal: Any,
                  centre: Any, turn: Any, shift: Any) -> Any:
    """Return what :func:`_plain_feet` returns."""
    nearest = _nearest(line, right, uv_px, points[0], left[0], first, step, offset[0], taper[0],
                       kind, k, focal, centre, turn[0], shift[0])
    count, far, last = len(line), _FAR_NODES * step, first + (points.shape[1] - 1) * step
    s_m, normal, residual = np.empty(count), np.zeros((count, 2)), np.full(count, _LOST_PX)
    for i in range(count):
        number, view = line[i], int(right[i])
        s, du, dv = first + nearest[i] * step, 0.0, 0.0
        for _ in range(_STEPS):
            u0, v0 = _at(points[0], left[0], first, step, offset[0, number], taper[0, number],
                         s - _STEP_M, kind[view], k[view], focal[view], centre[view],
                         turn[0, view], shift[0, view])
            u1, v1 = _at(points[0], left[0], first, step, offset[0, number], taper[0, number],
                         s + _STEP_M, kind[view], k[view], focal[view], centre[view],
                         turn[0, view], shift[0, view])
            du, dv = (u1 - u0) / (2 * _STEP_M), (v1 - v0) / (2 * _STEP_M)
            move = ((uv_px[i, 0] - (u0 + u1) / 2) * du + (uv_px[i, 1] - (v0 + v1) / 2) * dv) / (
                du * du + dv * dv)
            if move == move:
                s += min(max(move, -far), far)
            s = min(max(s, REACH * first), REACH * last)
        u, v = _at(points[0], left[0], first, step, offset[0, number], taper[0, number], s,
                   kind[view], k[view], focal[view], centre[view], turn[0, view],
                   shift[0, view])
        length = np.sqrt(du * du + dv * dv)
        off = (dv * (u - uv_px[i, 0]) - du * (v - uv_px[i, 1])) / length
        if np.isfinite(off):
            normal[i, 0], normal[i, 1], residual[i] = -dv / length, du / length, off
        s_m[i] = s
    return s_m, normal, residual
