# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Lines of a road in both views, and the feet of picks on them: the kernels of ``RoadProblem``.

The fit of a road asks for a few hundred pixels at a time, but so often that the overhead of
numpy's calls dominates.
"""
from __future__ import annotations

from typing import Any, Callable, NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray

from .model import RoadModel, Weights
from ..core.compiled import inlined, kernel
from ..core.records import Array
from ..geometry.projection import raw_pixels
from ..geometry.rig import StereoRig

REACH = 1.3  # distance from the middle, in half lengths, up to which feet are searched
LEAST_DEPTH_M = 0.1  # of a visible point
# Loops may not use constants and helpers of other files, see ``test_compiled``.
_RATIONAL, _EQUIDISTANT = 1, 2  # kinds of lenses, same as in ``geometry.projection``
_NEAR_AXIS = 1e-12  # same as in ``geometry.distortion``
_STEP_M = 0.01  # step along a line for its direction in the image
_LOST_PX = 1e3  # residual of a pick whose line is behind the camera; its derivative is 0
_ASTRAY_PX = 60.0  # cap of the distance by which a pick is assigned to a part of its line
_FAR_NODES = 3  # most nodes by which a step of Newton's method moves a foot
_STEPS = 3  # steps of Newton's method to a foot

# Projects points (k, n, 3) in the left camera's frame to raw pixels (k, n, 2) of its view or, if
# True, of the right one; NaN behind the camera.
See = Callable[[Array, bool], Array]


class Lines(NamedTuple):
    """
    Lines beside ``k`` reference lines, in the form that the kernels take.

    :param points_m: (k, nodes, 3) points of the reference lines, left optical frame, m.
    :param lateral: (k, nodes, 3) unit directions across the road there, to the left.
    :param first_m: arc length of the first node, m.
    :param step_m: arc length between nodes, m.
    :param offset_m: (k, lines) distance of each line from its reference line in the middle, m,
        positive to the left.
    :param taper: (k, lines) change of that distance for each metre along the road.
    """

    points_m: Array
    lateral: Array
    first_m: float
    step_m: float
    offset_m: Array
    taper: Array

    @classmethod
    def of(cls, model: RoadModel, x: Array, reference: tuple[Array, Array]) -> Lines:
        """
        Return the lines of roads.

        :param x: (k, size) parameters of the model.
        :param reference: points (k, nodes, 3) and frames (k, nodes, 3, 3) of ``model.reference``.
        """
        points, frames = reference
        offset = np.ascontiguousarray(model.offsets(x))
        return cls(points, np.ascontiguousarray(frames[..., 1]), float(model.s_m[0]),
                   float(model.s_m[1] - model.s_m[0]), offset,
                   np.ascontiguousarray(model.slopes(x)))

    @property
    def nodes_m(self) -> Array:
        """Return the arc lengths of the nodes, m."""
        return np.asarray(self.first_m + self.step_m * np.arange(self.points_m.shape[1]),
                          dtype=np.float64)


class RigViews(NamedTuple):
    """
    Left and right camera, in this order, in the form that the kernels take.

    :param kind: (2,) kinds of their lenses, see :class:`..geometry.projection.Projection`.
    :param coefficients: (2, 14) coefficients of their lenses.
    :param focal: (2, 3) fx, fy and skew, px.
    :param centre: (2, 2) principal points, px.
    :param rotation: (k, 2, 3, 3) rotations from the left camera's frame to theirs.
    :param origin_m: (k, 2, 3) origin of the left camera's frame in theirs, m.
    """

    kind: NDArray[np.int64]
    coefficients: Array
    focal: Array
    centre: Array
    rotation: Array
    origin_m: Array

    @classmethod
    def of(cls, rig: StereoRig) -> Optional[RigViews]:
        """Return the views of a calibrated rig; None if the kernels do not support its lenses."""
        two = [rig.left.projection, rig.right.projection]
        if not all(one.known for one in two):
            return None
        return cls(np.array([one.kind for one in two], dtype=np.int64),
                   np.array([one.coefficients for one in two]),
                   np.array([one.focal for one in two]), np.array([one.centre for one in two]),
                   np.stack([np.eye(3), rig.R])[None], np.stack([np.zeros(3), rig.t])[None])

    def drifted(self, drift: Array) -> RigViews:
        """
        Return the views of ``k`` rigs whose right cameras have rotated.

        :param drift: (k, 3, 3) matrices that transform row vectors to the rotated frames.
        """
        rotation, origin_m = (np.repeat(a, len(drift), axis=0)
                              for a in (self.rotation, self.origin_m))
        turn = np.swapaxes(drift, -1, -2)
        rotation[:, 1] = turn @ rotation[:, 1]
        origin_m[:, 1] = (turn @ origin_m[:, 1, :, None])[..., 0]
        return self._replace(rotation=rotation, origin_m=origin_m)

    def see(self, points_m: Array, right: bool) -> Array:
        """Return the raw pixels of points in one view, see :data:`See`."""
        i = int(right)
        here = points_m @ np.swapaxes(self.rotation[:, i], -1, -2) + self.origin_m[:, None, i]
        z = here[..., 2:]
        xy = here[..., :2] / np.where(z > LEAST_DEPTH_M, z, np.nan)
        return raw_pixels(xy, int(self.kind[i]), self.coefficients[i], self.focal[i],
                          self.centre[i])


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


def plain_pixels(line: NDArray[np.int64], right: NDArray[np.bool_], s_m: Array, lines: Lines,
                 see: See) -> Array:
    """
    Return the pixels (k, n, 2) of points of lines; NaN behind the camera.

    :param line: (n,) number of the line of each point.
    :param right: (n,) whether to project it into the right view.
    :param s_m: (n,) arc lengths, m.
    :param see: projects points into a view.
    """
    weights = Weights.at(lines.nodes_m, s_m)
    beside = lines.offset_m[:, line] + lines.taper[:, line] * s_m
    points = weights(lines.points_m) + beside[..., None] * weights(lines.lateral)
    uv_px = np.empty(points.shape[:-1] + (2,))
    for view in np.unique(right):
        mine = right == view
        uv_px[:, mine] = see(points[:, mine], bool(view))
    return uv_px


def plain_feet(line: NDArray[np.int64], right: NDArray[np.bool_], uv_px: Array, lines: Lines,
               see: See) -> tuple[Array, Array, Array]:
    """
    Return arc lengths (n,), m, normals (n, 2) and residuals (n,), px, of the feet of picks.

    A foot is the nearest point of the projected line, see :class:`.problem.Feet`.

    :param line: (n,) number of the line of each pick.
    :param right: (n,) whether it is in the right view.
    :param uv_px: (n, 2) raw pixels.
    :param lines: lines beside one reference line.
    :param see: projects points into a view.
    """
    if not len(line):
        return np.zeros(0), np.zeros((0, 2)), np.zeros(0)
    nodes, far, h = lines.nodes_m, _FAR_NODES * lines.step_m, _STEP_M
    s = nodes[_nearest_nodes(line, right, uv_px, lines, see)]
    for _ in range(_STEPS):
        here, after = (plain_pixels(line, right, s + d, lines, see)[0] for d in (-h, h))
        tangent, off = (after - here) / (2 * h), uv_px - (here + after) / 2
        step = np.sum(off * tangent, -1) / np.sum(tangent * tangent, -1)
        s = np.clip(s + np.nan_to_num(np.clip(step, -far, far)),
                    REACH * nodes[0], REACH * nodes[-1])
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / np.linalg.norm(
        tangent, axis=-1, keepdims=True)
    residual = np.sum(normal * (uv_px - plain_pixels(line, right, s, lines, see)[0]), axis=-1)
    lost = ~np.isfinite(residual)
    return s, np.where(lost[:, None], 0.0, normal), np.where(lost, _LOST_PX, residual)


def _nearest_nodes(line: NDArray[np.int64], right: NDArray[np.bool_], uv_px: Array,
                   lines: Lines, see: See) -> NDArray[np.intp]:
    """
    Return the node (n,) whose projection is nearest to each pick.

    The picks of a line are in order. If a hairpin or a crest brings the line back near itself in
    the image, the order determines which part of it a pick belongs to.
    """
    nodes, count = lines.nodes_m, lines.offset_m.shape[1]
    beside = lines.offset_m[0, :, None] + lines.taper[0, :, None] * nodes
    points = lines.points_m + beside[..., None] * lines.lateral
    seen = [see(points.reshape(1, -1, 3), view).reshape(count, len(nodes), 2)
            for view in (False, True)]
    groups = [(i, view, np.flatnonzero((line == i) & (right == view)))
              for i in range(count) for view in (False, True)]
    square = np.zeros((len(groups), max(len(mine) for _, _, mine in groups), len(nodes)))
    for group, (i, view, mine) in zip(square, groups):
        gap = uv_px[mine, None] - seen[view][i]
        group[:len(mine)] = np.fmin(np.sum(gap * gap, axis=-1), _ASTRAY_PX**2)
    nearest = np.zeros(len(line), dtype=np.intp)
    for (_, _, mine), columns in zip(groups, in_order(square)):
        nearest[mine] = columns[:len(mine)]
    return nearest


def _parts(of: tuple[Any, ...]) -> tuple[Lines, See]:
    """Return the lines and the projection, of which a kernel takes the parts."""
    count = len(Lines._fields)
    return Lines(*of[:count]), RigViews(*of[count:]).see


def _pixels(line: NDArray[np.int64], right: NDArray[np.bool_], s_m: Array, *of: Any) -> Array:
    """Return what :func:`plain_pixels` returns, of the parts of ``Lines`` and ``RigViews``."""
    return plain_pixels(line, right, s_m, *_parts(of))


def _feet(line: NDArray[np.int64], right: NDArray[np.bool_], uv_px: Array, *of: Any
          ) -> tuple[Array, Array, Array]:
    """Return what :func:`plain_feet` returns, of the parts of ``Lines`` and ``RigViews``."""
    return plain_feet(line, right, uv_px, *_parts(of))


@inlined
def _distorted(x, y, kind, k):  # type: ignore
    """Return the distorted coordinates of undistorted ones, as ``geometry.projection`` does."""
    r2 = x * x + y * y
    a, b = x, y
    if kind == _RATIONAL:
        radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (
            1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
        a = (x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x)
             + r2 * (k[8] + r2 * k[9]))
        b = (y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y
             + r2 * (k[10] + r2 * k[11]))
    elif kind == _EQUIDISTANT:
        radius = np.sqrt(r2)
        if radius > _NEAR_AXIS:
            theta = np.arctan(radius)
            t2 = theta * theta
            theta *= 1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))
            a, b = x * theta / radius, y * theta / radius
    return a, b


@inlined
def _pixel(x, y, z, camera):  # type: ignore
    """Return the pixel of a point in a view; NaN behind the camera."""
    kind, k, focal, centre, rotation, origin = camera
    depth = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + origin[2]
    if not depth > LEAST_DEPTH_M:
        depth = np.nan
    across = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + origin[0]
    down = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + origin[1]
    a, b = _distorted(across / depth, down / depth, kind, k)
    return focal[0] * a + focal[2] * b + centre[0], focal[1] * b + centre[1]


@inlined
def _pixel_at(s, line, camera):  # type: ignore
    """Return the pixel of a line at an arc length, by cubic interpolation between nodes."""
    points, lateral, first, step, offset, taper = line
    u = (s - first) / step
    i = min(max(int(np.floor(u)) - 1, 0), len(points) - 4)
    t, beside = u - i, offset + taper * s
    a, b = -(t - 1) * (t - 2) * (t - 3) / 6, t * (t - 2) * (t - 3) / 2
    c, d = -t * (t - 1) * (t - 3) / 2, t * (t - 1) * (t - 2) / 6
    x = (a * points[i, 0] + b * points[i + 1, 0] + c * points[i + 2, 0] + d * points[i + 3, 0]
         + beside * (a * lateral[i, 0] + b * lateral[i + 1, 0] + c * lateral[i + 2, 0]
                     + d * lateral[i + 3, 0]))
    y = (a * points[i, 1] + b * points[i + 1, 1] + c * points[i + 2, 1] + d * points[i + 3, 1]
         + beside * (a * lateral[i, 1] + b * lateral[i + 1, 1] + c * lateral[i + 2, 1]
                     + d * lateral[i + 3, 1]))
    z = (a * points[i, 2] + b * points[i + 1, 2] + c * points[i + 2, 2] + d * points[i + 3, 2]
         + beside * (a * lateral[i, 2] + b * lateral[i + 1, 2] + c * lateral[i + 2, 2]
                     + d * lateral[i + 3, 2]))
    return _pixel(x, y, z, camera)


@inlined
def _nodes_seen(line, camera, seen):  # type: ignore
    """Write the pixels of a line at all nodes to ``seen``."""
    points, lateral, first, step, offset, taper = line
    for n in range(len(points)):
        beside = offset + taper * (first + n * step)
        seen[n, 0], seen[n, 1] = _pixel(
            points[n, 0] + beside * lateral[n, 0], points[n, 1] + beside * lateral[n, 1],
            points[n, 2] + beside * lateral[n, 2], camera)


@inlined
def _nearest(mine, uv_px, seen, nearest):  # type: ignore
    """
    Write the nodes nearest to the picks of a line in one view to ``nearest``.

    That is the least total cost, by dynamic programming as in :func:`in_order`.

    :param mine: (m,) numbers of the picks.
    :param seen: (nodes, 2) pixels of the line.
    """
    total = np.zeros(len(seen))
    came = np.empty((len(mine), len(seen)), np.int64)  # node of the pick before
    for row in range(len(mine)):
        u, v = uv_px[mine[row], 0], uv_px[mine[row], 1]
        least, at = np.inf, 0
        for n in range(len(seen)):
            if total[n] <= least:
                least, at = total[n], n
            came[row, n] = at
            gap = (u - seen[n, 0])**2 + (v - seen[n, 1])**2
            total[n] = least + (gap if gap < _ASTRAY_PX**2 else _ASTRAY_PX**2)
    node = np.argmin(total)
    for row in range(len(mine) - 1, -1, -1):
        nearest[mine[row]] = node
        node = came[row, node]


@inlined
def _foot(u, v, s, line, camera):  # type: ignore
    """Return the arc length nearest to a pixel, the normal there, and the residual."""
    points, _, first, step, _, _ = line
    far, last, du, dv = _FAR_NODES * step, first + (len(points) - 1) * step, 0.0, 0.0
    for _ in range(_STEPS):
        u0, v0 = _pixel_at(s - _STEP_M, line, camera)
        u1, v1 = _pixel_at(s + _STEP_M, line, camera)
        du, dv = (u1 - u0) / (2 * _STEP_M), (v1 - v0) / (2 * _STEP_M)
        move = ((u - (u0 + u1) / 2) * du + (v - (v0 + v1) / 2) * dv) / (du * du + dv * dv)
        if move == move:
            s += min(max(move, -far), far)
        s = min(max(s, REACH * first), REACH * last)
    on_u, on_v = _pixel_at(s, line, camera)
    length = np.sqrt(du * du + dv * dv)
    off = (dv * (on_u - u) - du * (on_v - v)) / length
    if np.isfinite(off):
        return s, -dv / length, du / length, off
    return s, 0.0, 0.0, _LOST_PX


_OF = ('f8[:,:,::1], f8[:,:,::1], f8, f8, f8[:,::1], f8[:,::1], i8[::1], f8[:,::1], f8[:,::1], '
       'f8[:,::1], f8[:,:,:,::1], f8[:,:,::1]')


@kernel(_pixels, f'(i8[::1], b1[::1], f8[::1], {_OF})')
def pixels_of_lines(line: Any, right: Any, s_m: Any, points: Any, lateral: Any, first: float,
                    step: float, offset: Any, taper: Any, kind: Any, k: Any, focal: Any,
                    centre: Any, rotation: Any, origin: Any) -> Any:
    """Return what :func:`_pixels` returns."""
    out = np.empty((len(points), len(s_m), 2))
    for j in range(len(points)):
        for i in range(len(s_m)):
            number, view = line[i], int(right[i])
            out[j, i, 0], out[j, i, 1] = _pixel_at(
                s_m[i],
                (points[j], lateral[j], first, step, offset[j, number], taper[j, number]),
                (kind[view], k[view], focal[view], centre[view], rotation[j, view],
                 origin[j, view]))
    return out


@kernel(_feet, f'(i8[::1], b1[::1], f8[:,::1], {_OF})')
def feet_on_lines(line: Any, right: Any, uv_px: Any, points: Any, lateral: Any, first: float,
                  step: float, offset: Any, taper: Any, kind: Any, k: Any, focal: Any,
                  centre: Any, rotation: Any, origin: Any) -> Any:
    """Return what :func:`_feet` returns."""
    count, nodes = len(line), points.shape[1]
    s_m, normal, residual = np.empty(count), np.empty((count, 2)), np.empty(count)
    nearest, seen = np.empty(count, np.int64), np.empty((nodes, 2))
    for group in range(2 * offset.shape[1]):
        number, view = group // 2, group % 2
        of = (points[0], lateral[0], first, step, offset[0, number], taper[0, number])
        camera = (kind[view], k[view], focal[view], centre[view], rotation[0, view],
                  origin[0, view])
        mine = np.flatnonzero((line == number) & (right == (view == 1)))
        if not len(mine):
            continue
        _nodes_seen(of, camera, seen)
        _nearest(mine, uv_px, seen, nearest)
        for i in mine:
            s_m[i], normal[i, 0], normal[i, 1], residual[i] = _foot(
                uv_px[i, 0], uv_px[i, 1], first + nearest[i] * step, of, camera)
    return s_m, normal, residual
