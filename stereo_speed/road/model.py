# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The shape of a road: a reference line that curves and climbs, and lines parallel to it.

The road's frame at reference arc length ``s`` is ``G Rz(psi(s)) Ry(-theta(s)) Rx(phi(s))``:
heading ``psi`` about a fixed up axis, the integral of a polynomial curvature; grade ``theta``, the
integral of a polynomial vertical curvature; crossfall ``phi``, the integral of a polynomial twist.
A straight grade needs none of these, because the plane tilts with it; a curve that climbs does.
As roads are built, a grade goes over into the next one in a *vertical curve*, a parabola, whose
two ends no polynomial follows.

The parameters are one vector: small rotation of the guess (3), height (1), a lateral offset for
each line, on demand a taper for each line, and the coefficients of the shape.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ..core.records import Array

NODES = 81  # along the reference line
# Numbers of one: its middle, the logarithm of its length, in half lengths, and its change, rad.
VERTICAL_CURVE = 3
_OVERHANG = 1.1  # half lengths from the middle to the last node; lines go on a little
# Of vertical curves that are tried: middles along what is seen, and lengths as shares of it.
_MIDDLES, _LENGTHS = 21, np.geomspace(0.1, 1, 9)


class RoadShape(NamedTuple):
    """
    How many numbers describe how a road departs from a straight one on a plane.

    :param curvature: coefficients of its curvature.
    :param tilt: 2 where grade and crossfall in the middle are free, 0 where they are 0.
    :param vertical: coefficients of its vertical curvature.
    :param twist: coefficients of the change of its crossfall.
    :param vertical_curve: ``VERTICAL_CURVE`` where one grade goes over into another, or 0.
    """

    curvature: int = 0
    tilt: int = 0
    vertical: int = 0
    twist: int = 0
    vertical_curve: int = 0

    @property
    def flat(self) -> bool:
        """Return whether the surface is a plane."""
        return not any(self[1:])


@dataclass(frozen=True, eq=False)
class RoadModel:
    """
    A family of roads about a guess.

    :param frame: (3, 3) columns T, P left, B up in the middle, left optical frame.
    :param centre_m: (3,) in the middle of the road.
    :param half_length_m: from the middle to the furthest pick.
    :param lines: number of lines.
    :param shape: what is free.
    :param tapered: each line may run off from the others, evenly along the road.
    """

    frame: Array
    centre_m: Array
    half_length_m: float
    lines: int
    shape: RoadShape = RoadShape()
    tapered: bool = False

    @property
    def size(self) -> int:
        """Length of the parameter vector."""
        return self._first + sum(self.shape)

    @property
    def _first(self) -> int:
        """Place of the first coefficient of the shape."""
        return 4 + self.lines * (2 if self.tapered else 1)

    @cached_property
    def places(self) -> RoadPlaces:
        """Return where the parameters of each kind stand."""
        ends = self._first + np.cumsum(self.shape)
        return RoadPlaces(slice(4, 4 + self.lines), slice(4 + self.lines, self._first), *(
            slice(int(end) - count, int(end)) for end, count in zip(ends, self.shape)))

    def columns(self, shape: RoadShape, count: int) -> NDArray[np.intp]:
        """
        Return which unknowns a narrower family keeps.

        :param shape: of that family.
        :param count: of the unknowns, those that follow the parameters included.
        """
        keep = np.ones(count, dtype=bool)
        for place, count in zip(self.places[2:], shape):
            keep[place.start + count:place.stop] = False
        return np.flatnonzero(keep)

    @cached_property
    def steps(self) -> Array:
        """Return the (size,) differences that move the picks by something like 1e-3 px."""
        out = np.full(self.size, 1e-6)
        out[3:self._first] = 1e-5
        out[self.places.vertical_curve][:-1] = 1e-5
        return out

    @cached_property
    def s_m(self) -> Array:
        """Arc lengths (NODES,) of the nodes from the middle."""
        return np.linspace(-1, 1, NODES) * _OVERHANG * self.half_length_m

    def reshaped(self, shape: RoadShape, x: Array, tapered: bool = False
                 ) -> tuple[RoadModel, Array]:
        """
        Return another family about the same guess, and the parameters nearest to a road in it.

        :param x: (size,) parameters of the road, or more.
        :param shape: of that family; coefficients that it lacks are dropped, further ones 0.
        :param tapered: see :class:`RoadModel`.
        """
        other = replace(self, shape=shape, tapered=tapered)
        out = np.zeros(other.size)
        out[:4] = x[:4]
        for mine, its in zip(self.places, other.places):
            count = min(mine.stop - mine.start, its.stop - its.start)
            out[its.start:its.start + count] = x[mine.start:mine.start + count]
        return other, np.concatenate([out, x[self.size:]])

    @cached_property
    def _basis(self) -> Array:
        """Integrals (2 NODES - 1, terms) of Legendre polynomials, at nodes and between."""
        sigma = self._between
        terms = max(self.shape.curvature, self.shape.vertical, self.shape.twist, 1)
        return np.stack([legendre.legval(sigma, legendre.legint(row, lbnd=0))
                         for row in np.eye(terms)], axis=-1)

    def _integral(self, coefficients: Array) -> Array:
        """Return the integral (..., 2 NODES - 1) of a polynomial (..., terms); 0 in the middle."""
        return np.asarray(coefficients @ self._basis[:, :coefficients.shape[-1]].T)

    @cached_property
    def _between(self) -> Array:
        """Places (2 NODES - 1,) of the nodes and between, in half lengths from the middle."""
        return np.linspace(-1, 1, 2 * NODES - 1) * _OVERHANG

    def _vertical_curve(self, numbers: Array) -> Array:
        """Return the grades (..., 2 NODES - 1) by a vertical curve (..., 3) or none (..., 0)."""
        if not numbers.shape[-1]:
            return np.zeros(numbers.shape[:-1] + (1,))
        middle, log_length, change = (numbers[..., i, None] for i in range(VERTICAL_CURVE))
        return np.asarray(change * _ramp(self._between, middle, np.exp(log_length)))

    def as_built(self, shape: RoadShape, x: Array, seen_m: tuple[float, float]
                 ) -> tuple[RoadModel, Array]:
        """
        Return a family with a vertical curve, and the road in it that is near.

        :param shape: of that family: with the vertical curve, and without the polynomial of one.
        :param x: (size,) parameters of the road, or more.
        :param seen_m: arc lengths between which they are to be alike.
        """
        other, out = self.reshaped(shape, x, self.tapered)
        near, up_m, grade = self._vertical_curve_near(x[self.places.vertical], seen_m)
        out[other.places.vertical_curve] = near
        out[3] += up_m
        if shape.tilt:
            out[other.places.tilt.start] += grade
        else:
            out[1] -= grade
        return other, out

    def _vertical_curve_near(self, coefficients: Array, seen_m: tuple[float, float]
                             ) -> tuple[Array, float, float]:
        """
        Return the vertical curve that climbs most like a polynomial of vertical curvature.

        :param seen_m: arc lengths between which they are compared.
        :return: its numbers, and the height, m, and grade that are to be added.
        """
        u, step = self._between, self._between[1] - self._between[0]
        begin, end = np.array(seen_m) / self.half_length_m
        inner = (u >= begin) & (u <= end)

        def climbed(grades: Array) -> Array:
            way = (np.cumsum(grades) - grades / 2) * step
            return np.asarray((way - way[NODES - 1])[inner])
        want, tries = climbed(self._integral(coefficients)), []
        for middle, length in product(np.linspace(begin, end, _MIDDLES),
                                      (end - begin) * _LENGTHS):
            ramp = climbed(_ramp(u, middle, length))
            basis = np.column_stack([ramp, np.ones_like(ramp), u[inner]])
            found = np.linalg.lstsq(basis, want, rcond=None)[0]
            off = basis @ found - want
            tries.append((float(off @ off), middle, np.log(length), *found))
        _, middle, log_length, change, up, grade = min(tries)
        return np.array([middle, log_length, change]), up * self.half_length_m, grade

    def offsets(self, x: Array) -> Array:
        """Return the (..., lines) lateral places of the lines, m, positive to the left."""
        return x[..., self.places.offsets]

    def offsets_at(self, x: Array, line: NDArray[np.intp], s_m: Array) -> Array:
        """
        Return the lateral places (..., n) of lines where they are looked at, tapers included.

        :param line: (n,) their numbers.
        :param s_m: (n,) arc lengths.
        """
        out: Array = x[..., self.places.offsets][..., line]
        if self.tapered:
            out = out + x[..., self.places.tapers][..., line] * (s_m / self.half_length_m)
        return np.asarray(out)

    def tilt(self, x: Array) -> Array:
        """Return grade and crossfall in the middle (..., 2), rad; 0 where they are not free."""
        return x[..., self.places.tilt] if self.shape.tilt else np.zeros(x.shape[:-1] + (2,))

    def reference(self, x: Array) -> tuple[Array, Array]:
        """
        Return the reference line's points (..., NODES, 3) and frames (..., NODES, 3, 3).

        :param x: (..., size) parameters.
        """
        psi, climb, roll = (self._integral(x[..., part]) for part in (
            self.places.curvature, self.places.vertical, self.places.twist))
        tilt = self.tilt(x)
        theta = tilt[..., :1] + climb + self._vertical_curve(x[..., self.places.vertical_curve])
        phi = tilt[..., 1:] + roll
        cp, sp, ct, st = np.cos(psi), np.sin(psi), np.cos(theta), np.sin(theta)
        cf, sf = np.cos(phi), np.sin(phi)
        tangent = np.stack([cp * ct, sp * ct, st], axis=-1)
        left = np.stack([-sp * cf - cp * st * sf, cp * cf - sp * st * sf, ct * sf], axis=-1)
        axes = self.frame @ rotation(x[..., :3])
        step = self.s_m[1] - self.s_m[0]
        simpson = step / 6 * (tangent[..., :-2:2, :] + 4 * tangent[..., 1::2, :]
                              + tangent[..., 2::2, :])
        way = np.concatenate(
            [np.zeros_like(tangent[..., :1, :]), np.cumsum(simpson, axis=-2)], axis=-2)
        way = way - way[..., NODES // 2:NODES // 2 + 1, :]
        tangent, left = tangent[..., ::2, :], left[..., ::2, :]
        local = np.stack([tangent, left, np.cross(tangent, left)], axis=-1)
        origin = self.centre_m + x[..., 3:4] * self.frame[:, 2]
        points = origin[..., None, :] + way @ np.swapaxes(axes, -1, -2)
        return points, axes[..., None, :, :] @ local


class RoadPlaces(NamedTuple):
    """
    Where the parameters of each kind stand in the vector of a :class:`RoadModel`.

    :param offsets: lateral places of the lines, m.
    :param tapers: by how much each line runs off over half the length, m.
    :param curvature: rad per half length.
    :param tilt: grade and crossfall in the middle, rad.
    :param vertical: rad per half length.
    :param twist: rad per half length.
    :param vertical_curve: middle and logarithm of the length, half lengths; change of grade, rad.
    """

    offsets: slice
    tapers: slice
    curvature: slice
    tilt: slice
    vertical: slice
    twist: slice
    vertical_curve: slice


def _ramp(u: Array, middle: Array, length: Array) -> Array:
    """
    Return how much of a vertical curve lies behind places (n,), against the middle of the road.

    Its ends are rounded over the distance of two nodes, as pavers round them; the nodes do
    not show more, and it changes smoothly with its ends.

    :param u: in half lengths, as are the others.
    :param middle: (..., 1) of the curve.
    :param length: (..., 1) of it.
    """
    half = _OVERHANG / (NODES - 1)

    def area(places: Array) -> Array:
        """Return the integral of a ramp from 0 to 1 up to places."""
        part = (places - middle) / length + 0.5
        return np.asarray((np.maximum(part, 0.0)**2 - np.maximum(part - 1, 0.0)**2) * length / 2)
    behind, zero = ((area(v + half) - area(v - half)) / (2 * half) for v in (u, np.zeros(1)))
    return np.asarray(behind - zero)


def rotation(vectors: Array) -> Array:
    """Return the matrices (..., 3, 3) of rotation vectors (..., 3)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    o = np.zeros_like(x)
    skew = np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(vectors.shape[:-1] + (3, 3))
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(angle / (2 * np.pi))**2
    return np.asarray(np.eye(3) + a * skew + b * skew @ skew)


def drift_matrix(drift_rad: Array) -> Array:
    """
    Return the matrices (..., 3, 3) that take row vectors into the frame of a rotated camera.

    :param drift_rad: (..., 3) pan to the right, tilt upwards and roll clockwise, components of
        one rotation vector about the camera's y, x and z axis.
    """
    return rotation(drift_rad[..., [1, 0, 2]])


@dataclass(frozen=True, eq=False)
class Weights:
    """
    Cubic interpolation between nodes at fixed places.

    :param matrix: (n, NODES) weights, 4 of each row not zero.
    """

    matrix: Array

    @classmethod
    def at(cls, nodes_m: Array, s_m: Array) -> Weights:
        """
        Return the weights for arc lengths (n,); beyond the nodes they extrapolate.

        :param nodes_m: (NODES,) even.
        """
        u = (s_m - nodes_m[0]) / (nodes_m[1] - nodes_m[0])
        i = np.clip(np.floor(u).astype(int) - 1, 0, len(nodes_m) - 4)
        t = u - i
        value = np.stack([
            -(t - 1) * (t - 2) * (t - 3) / 6, t * (t - 2) * (t - 3) / 2,
            -t * (t - 1) * (t - 3) / 2, t * (t - 1) * (t - 2) / 6], axis=-1)
        matrix = np.zeros((len(s_m), len(nodes_m)))
        np.put_along_axis(matrix, i[:, None] + np.arange(4), value, axis=1)
        return cls(matrix)

    def __call__(self, values: Array) -> Array:
        """Interpolate values (..., NODES, 3): (..., n, 3)."""
        return np.asarray(self.matrix @ values)
