# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The shape of a road: a reference line that curves and climbs, and lines parallel to it.

The road's frame at reference arc length ``s`` is ``G Rz(psi(s)) Ry(-theta(s)) Rx(phi(s))``, where
``G`` is the frame in the middle of the road.  The heading ``psi`` about a fixed up axis is the
integral of a polynomial curvature, the grade ``theta`` that of a polynomial vertical curvature,
and the crossfall ``phi`` that of a polynomial twist.  A straight road of constant grade needs
none of them, because the plane tilts with it; a curve that climbs does.  Real roads join two
grades by a *vertical curve*, a parabola, whose two ends a polynomial cannot follow, and build up
the crossfall of bends in a *run-off* (:mod:`.run_off`).

The parameters form one vector: a small rotation of the guess (3), a height (1), a lateral offset
for each line, optionally a taper for each line, and the coefficients of the shape.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from .reference_kernel import along
from .run_off import changes
from ..core.records import Array

NODES = 81  # number of nodes along the reference line
# Parameters of a vertical curve: middle and logarithm of the length, in half lengths of the road,
# and change of grade, rad.
VERTICAL_CURVE = 3
_OVERHANG = 1.1  # distance of the last node from the middle, in half lengths of the road
_SHORTEST = 1e-6  # least length of a vertical curve, in half lengths of the road
# Initial vertical curves: number of middles along the seen stretch, and lengths as shares of it.
_MIDDLES, _LENGTHS = 21, np.geomspace(0.1, 1, 9)


class RoadShape(NamedTuple):
    """
    Numbers of parameters that describe how a road differs from a straight one on a plane.

    :param curvature: number of coefficients of the curvature.
    :param tilt: 2 if grade and crossfall in the middle are free, else 0.
    :param vertical: number of coefficients of the vertical curvature.
    :param twist: number of coefficients of the twist, the change of the crossfall.
    :param vertical_curve: ``VERTICAL_CURVE`` if the road has a vertical curve, else 0.
    :param run_off: ``RUN_OFF`` if its crossfall changes as along a run-off, else 0.
    """

    curvature: int = 0
    tilt: int = 0
    vertical: int = 0
    twist: int = 0
    vertical_curve: int = 0
    run_off: int = 0

    @property
    def flat(self) -> bool:
        """Return whether the surface is a plane."""
        return not any(self[1:])


@dataclass(frozen=True, eq=False)
class RoadModel:
    """
    A family of roads about a guess.

    :param frame: (3, 3) columns T, P left, B up in the middle of the road, left optical frame.
    :param centre_m: (3,) point in the middle of the road, left optical frame, m.
    :param half_length_m: distance from the middle to the farthest pick, m.
    :param lines: number of lines.
    :param shape: free parameters of the shape.
    :param tapered: whether each line may diverge from the others, linearly along the road.
    """

    frame: Array
    centre_m: Array
    half_length_m: float
    lines: int
    shape: RoadShape = RoadShape()
    tapered: bool = False

    @property
    def size(self) -> int:
        """Return the length of the parameter vector."""
        return self._first + sum(self.shape)

    @property
    def _first(self) -> int:
        """Return the index of the first coefficient of the shape."""
        return 4 + self.lines * (2 if self.tapered else 1)

    @cached_property
    def places(self) -> RoadPlaces:
        """Return the places of each kind of parameter in the vector."""
        ends = self._first + np.cumsum(self.shape)
        return RoadPlaces(slice(4, 4 + self.lines), slice(4 + self.lines, self._first), *(
            slice(int(end) - count, int(end)) for end, count in zip(ends, self.shape)))

    def columns(self, shape: RoadShape, count: int) -> NDArray[np.intp]:
        """
        Return the indices of the unknowns that a narrower family keeps.

        :param shape: shape of that family.
        :param count: number of unknowns, including those that follow the parameters.
        """
        keep = np.ones(count, dtype=bool)
        for place, count in zip(self.places[2:], shape):
            keep[place.start + count:place.stop] = False
        return np.flatnonzero(keep)

    @cached_property
    def steps(self) -> Array:
        """Return (size,) steps for finite differences; each moves the picks by about 1e-3 px."""
        out = np.full(self.size, 1e-6)
        out[3:self._first] = 1e-5
        out[self.places.vertical_curve][:-1] = 1e-5
        out[self.places.run_off][-1:] = 1e-4
        return out

    @cached_property
    def s_m(self) -> Array:
        """Return the arc lengths (NODES,) of the nodes, from the middle, m."""
        return np.linspace(-1, 1, NODES) * _OVERHANG * self.half_length_m

    def reshaped(self, shape: RoadShape, x: Array, tapered: bool = False
                 ) -> tuple[RoadModel, Array]:
        """
        Return another family about the same guess, and the parameters there closest to a road.

        :param shape: shape of that family; coefficients that it lacks are dropped, new ones are 0.
        :param x: (size,) parameters of the road; further unknowns may follow and are kept.
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
        """Return integrals (2 NODES - 1, terms) of Legendre polynomials at nodes and midpoints."""
        sigma = self._between
        terms = max(self.shape.curvature, self.shape.vertical, self.shape.twist, 1)
        return np.stack([legendre.legval(sigma, legendre.legint(row, lbnd=0))
                         for row in np.eye(terms)], axis=-1)

    def _integral(self, coefficients: Array) -> Array:
        """Return the integral (..., 2 NODES - 1) of a polynomial (..., terms); 0 in the middle."""
        return np.asarray(coefficients @ self._basis[:, :coefficients.shape[-1]].T)

    @cached_property
    def _between(self) -> Array:
        """Return nodes and midpoints (2 NODES - 1,), in half lengths from the middle."""
        return np.linspace(-1, 1, 2 * NODES - 1) * _OVERHANG

    def _vertical_curve(self, numbers: Array) -> Array:
        """Return the grades (..., 2 NODES - 1) of a vertical curve (..., 3), or 0 for (..., 0)."""
        if not numbers.shape[-1]:
            return np.zeros(numbers.shape[:-1] + (1,))
        middle, log_length, change = (numbers[..., i, None] for i in range(VERTICAL_CURVE))
        return np.asarray(change * _ramp(self._between, middle, np.exp(log_length)))

    def as_built(self, shape: RoadShape, x: Array, seen_m: tuple[float, float]
                 ) -> tuple[RoadModel, Array]:
        """
        Return a family with a vertical curve, and the parameters there closest to a road.

        :param shape: shape of that family, with a vertical curve and no vertical curvature.
        :param x: (size,) parameters of the road; further unknowns may follow and are kept.
        :param seen_m: arc lengths between which the two roads should agree, m.
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
        Return the vertical curve whose heights are closest to those of a polynomial.

        :param coefficients: coefficients of the vertical curvature.
        :param seen_m: arc lengths between which the heights are compared, m.
        :return: its parameters, and the height, m, and grade, rad, to add to the road.
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
        """Return the (..., lines) lateral offsets of the lines, m, positive to the left."""
        return x[..., self.places.offsets]

    def slopes(self, x: Array) -> Array:
        """Return the (..., lines) changes of these offsets for each metre along the road."""
        if not self.tapered:
            return np.zeros_like(self.offsets(x))
        return np.asarray(x[..., self.places.tapers] / self.half_length_m)

    def offsets_at(self, x: Array, line: NDArray[np.intp], s_m: Array) -> Array:
        """
        Return the lateral offsets (..., n) of lines at arc lengths, tapers included, m.

        :param line: (n,) numbers of the lines.
        :param s_m: (n,) arc lengths, m.
        """
        return np.asarray(self.offsets(x)[..., line] + self.slopes(x)[..., line] * s_m)

    def tilt(self, x: Array) -> Array:
        """Return grade and crossfall in the middle (..., 2), rad; 0 if they are not free."""
        return x[..., self.places.tilt] if self.shape.tilt else np.zeros(x.shape[:-1] + (2,))

    def reference(self, x: Array) -> tuple[Array, Array]:
        """
        Return the reference line's points (..., NODES, 3) and frames (..., NODES, 3, 3).

        :param x: (..., size) parameters.
        """
        many = x.reshape(-1, x.shape[-1])
        psi, climb, roll = (self._integral(many[:, part]) for part in (
            self.places.curvature, self.places.vertical, self.places.twist))
        tilt = self.tilt(many)
        theta = tilt[:, :1] + climb + self._vertical_curve(many[:, self.places.vertical_curve])
        phi = tilt[:, 1:] + roll
        turned = changes(many[:, self.places.run_off], self._between, self.half_length_m)
        axes = self.frame @ rotation(many[:, :3])
        origin_m = self.centre_m + many[:, 3:4] * self.frame[:, 2]
        points, frames = along(psi + turned[0], theta + turned[1], phi + turned[2], axes, origin_m,
                               self.s_m[1] - self.s_m[0])
        return (points.reshape(x.shape[:-1] + points.shape[1:]),
                frames.reshape(x.shape[:-1] + frames.shape[1:]))


class RoadPlaces(NamedTuple):
    """
    The places of each kind of parameter in the vector of a :class:`RoadModel`.

    :param offsets: lateral offsets of the lines, m.
    :param tapers: divergence of each line over half the length of the road, m.
    :param curvature: coefficients of the curvature, rad per half length.
    :param tilt: grade and crossfall in the middle, rad.
    :param vertical: coefficients of the vertical curvature, rad per half length.
    :param twist: coefficients of the twist, rad per half length.
    :param vertical_curve: middle and logarithm of the length, in half lengths; change of grade,
        rad.
    :param run_off: see :data:`.run_off.RUN_OFF`.
    """

    offsets: slice
    tapers: slice
    curvature: slice
    tilt: slice
    vertical: slice
    twist: slice
    vertical_curve: slice
    run_off: slice


def _ramp(u: Array, middle: Array, length: Array) -> Array:
    """
    Return which share of a vertical curve lies before places (n,), less that before the middle.

    The ends of the curve are rounded over the distance of two nodes, as a paver does. The nodes
    cannot resolve more, and the result becomes a smooth function of the ends.

    :param u: (n,) places along the road, in half lengths, as all lengths here.
    :param middle: (..., 1) middle of the curve.
    :param length: (..., 1) length of the curve.
    """
    half = _OVERHANG / (NODES - 1)
    length = np.maximum(length, _SHORTEST)  # a search may try one of no length at all

    def area(places: Array) -> Array:
        """Return the integral of a ramp from 0 to 1 up to places."""
        part = (places - middle) / length + 0.5
        return np.asarray((np.clip(part, 0.0, 1.0)**2 / 2 + np.maximum(part - 1, 0.0)) * length)
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
    Return the matrices (..., 3, 3) that transform row vectors to the frame of a rotated camera.

    :param drift_rad: (..., 3) pan to the right, tilt upwards and roll clockwise, components of
        one rotation vector about the camera's y, x and z axis.
    """
    return rotation(drift_rad[..., [1, 0, 2]])


@dataclass(frozen=True, eq=False)
class Weights:
    """
    Cubic interpolation between nodes at fixed places.

    :param matrix: (n, NODES) weights, of which 4 in each row are not zero.
    """

    matrix: Array

    @classmethod
    def at(cls, nodes_m: Array, s_m: Array) -> Weights:
        """
        Return the weights for arc lengths (n,); beyond the nodes they extrapolate.

        :param nodes_m: (NODES,) evenly spaced arc lengths of the nodes, m.
        :param s_m: (n,) arc lengths, m.
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
