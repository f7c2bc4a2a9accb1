# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The shape of a road: a reference line that curves and climbs, and lines parallel to it.

The road's frame at reference arc length ``s`` is ``G Rz(psi(s)) Ry(-theta(s)) Rx(phi)``: heading
``psi`` about a fixed up axis, the integral of a polynomial curvature; grade ``theta = theta_0 +
crest s``; crossfall ``phi``. With both at zero the road is a plane. A straight grade needs
neither, because the plane tilts with it; a curve that climbs does.

The parameters are one vector: small rotation of the guess (3), height (1), a lateral offset for
each line, the curvature coefficients and the first few of grade, crossfall and crest.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre

from ..core.records import Array

NODES = 81  # along the reference line
SURFACE = ('grade', 'crossfall', 'crest')  # rad, rad, rad per half length
_OVERHANG = 1.1  # half lengths from the middle to the last node; lines go on a little


@dataclass(frozen=True, eq=False)
class RoadModel:
    """
    A family of roads about a guess.

    :param frame: (3, 3) columns T, P left, B up in the middle, left optical frame.
    :param centre_m: (3,) in the middle of the road.
    :param half_length_m: from the middle to the furthest pick.
    :param lines: number of lines.
    :param curvature_terms: number of curvature coefficients; 0 is a straight road.
    :param surface_terms: how many terms of ``SURFACE`` are free, in its order; 0 is a plane.
    """

    frame: Array
    centre_m: Array
    half_length_m: float
    lines: int
    curvature_terms: int
    surface_terms: int

    @property
    def size(self) -> int:
        """Length of the parameter vector."""
        return 4 + self.lines + self.curvature_terms + self.surface_terms

    @cached_property
    def steps(self) -> Array:
        """Return the (size,) differences that move the picks by something like 1e-3 px."""
        return np.concatenate([
            np.full(3, 1e-6), np.full(1 + self.lines, 1e-5),
            np.full(self.curvature_terms + self.surface_terms, 1e-6)])

    @cached_property
    def s_m(self) -> Array:
        """Arc lengths (NODES,) of the nodes from the middle."""
        return np.linspace(-1, 1, NODES) * _OVERHANG * self.half_length_m

    def widened(self, curvature_terms: int, surface_terms: int, x: Array
                ) -> tuple[RoadModel, Array]:
        """
        Return a wider family, and the parameters of the road of ``x`` (size,) or more in it.

        :param curvature_terms: at least as many as now.
        :param surface_terms: at least as many as now.
        """
        wide = replace(self, curvature_terms=curvature_terms, surface_terms=surface_terms)
        cut = self.size - self.surface_terms
        return wide, np.concatenate([
            x[:cut], np.zeros(curvature_terms - self.curvature_terms), x[cut:self.size],
            np.zeros(surface_terms - self.surface_terms), x[self.size:]])

    @cached_property
    def _heading_basis(self) -> Array:
        """Heading (2 NODES - 1, curvature_terms) of unit coefficients, at nodes and between."""
        sigma = np.linspace(-1, 1, 2 * NODES - 1) * _OVERHANG
        basis = [legendre.legval(sigma, legendre.legint(np.eye(self.curvature_terms)[i], lbnd=0))
                 for i in range(self.curvature_terms)]
        return np.stack(basis, axis=-1) if basis else np.zeros((sigma.size, 0))

    def offsets(self, x: Array) -> Array:
        """Return the (..., lines) lateral places of the lines, m, positive to the left."""
        return x[..., 4:4 + self.lines]

    def surface(self, x: Array) -> Array:
        """Return grade, crossfall and crest (..., 3); those that are not free are 0."""
        out = np.zeros(x.shape[:-1] + (len(SURFACE),))
        out[..., :self.surface_terms] = x[..., self.size - self.surface_terms:self.size]
        return out

    def reference(self, x: Array) -> tuple[Array, Array]:
        """
        Return the reference line's points (..., NODES, 3) and frames (..., NODES, 3, 3).

        :param x: (..., size) parameters.
        """
        psi = x[..., 4 + self.lines:self.size - self.surface_terms] @ self._heading_basis.T
        grade, fall, crest = np.moveaxis(self.surface(x), -1, 0)[..., None]
        theta = grade + crest * np.linspace(-1, 1, 2 * NODES - 1) * _OVERHANG
        cp, sp, ct, st = np.cos(psi), np.sin(psi), np.cos(theta), np.sin(theta)
        cf, sf = np.cos(fall), np.sin(fall)
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
