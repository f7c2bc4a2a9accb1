# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The state of a target as particles (2010, Section II.A and IV.B).

The dynamics state y is position, size and angle of the box and their rates; the environment state
e = [d, d_rate] is the distance at the box's reference point, looked up in the field, and its rate.
An upright object touches the ground at the middle of its lower edge, which is its reference point.
The reference point of an oriented box is its centre (Section V.A).
"""
from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from .boxes import Target
from ..core.records import Array
from ..estimation.resampling import systematic


@dataclass(frozen=True, eq=False, kw_only=True)
class Particles:
    """
    N states.

    :param point_px: (N, 2), reference point, px.
    :param velocity_px: (N, 2), its velocity, px per frame.
    :param size_px: (N, 2), width and height of the box, px.
    :param size_rate: (N, 2), rate of the logarithm of the size, per frame.
    :param angle_rad: (N,), angle of the box.
    :param spin_rad: (N,), rate of the angle, per frame.
    :param distance_rate_px: (N,), rate of the distance d, px per frame.
    :param horizon_px: (N,), row of the horizon, px.
    :param deviation: (N, 2), logarithm of the ratio of the size to the perspective size.
    """

    point_px: Array
    velocity_px: Array
    size_px: Array
    size_rate: Array
    angle_rad: Array
    spin_rad: Array
    distance_rate_px: Array
    horizon_px: Array
    deviation: Array

    def __len__(self) -> int:
        return len(self.point_px)

    @property
    def scale_px(self) -> Array:
        """Return the scale (N,) of the noise: the square root of the box's area, px."""
        return np.asarray(np.sqrt(self.size_px[:, 0] * self.size_px[:, 1]))

    def take(self, index: NDArray[np.intp]) -> Particles:
        """Return the particles with the given indices."""
        return replace(self, **{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def resampled(self, weights: Array, rng: np.random.Generator) -> Particles:
        """Return the same number of particles, resampled systematically by their weights."""
        return self.take(systematic(weights, len(self), rng))


def reference_point(box_px: Array, upright: bool) -> Array:
    """Return the reference point (2,) of a box (4,), px."""
    x, y, w, h = box_px
    return np.array([x + w / 2, y + h if upright else y + h / 2])


def mean_box(particles: Particles, weights: Array, upright: bool) -> tuple[Array, float]:
    """
    Return the posterior mean as a box (eq. 14): (4,) px, and its angle.

    Sizes are averaged as logarithms, and angles on the circle.
    """
    x, y = weights @ particles.point_px
    w, h = np.exp(weights @ np.log(particles.size_px))
    if upright:
        return np.array([x - w / 2, y - h, w, h]), 0.0
    angle = np.angle(weights @ np.exp(1j * particles.angle_rad))
    return np.array([x - w / 2, y - h / 2, w, h]), float(angle)


def first_particles(target: Target, count: int, start_speed: float, horizon_px: Array,
                    rng: np.random.Generator) -> Particles:
    """
    Draw the initial particles of a target, with known box and unknown velocity.

    :param start_speed: spread of the velocity, per axis, as a share of the size.
    :param horizon_px: (N,) rows of the horizon.
    """
    box = target.box_px
    scale = float(np.sqrt(box[2] * box[3]))
    zeros = np.zeros((count, 2))
    return Particles(
        point_px=np.tile(reference_point(box, target.upright), (count, 1)),
        velocity_px=start_speed * scale * rng.standard_normal((count, 2)),
        size_px=np.tile(box[2:], (count, 1)), size_rate=zeros,
        angle_rad=np.full(count, target.angle_rad), spin_rad=zeros[:, 0],
        distance_rate_px=zeros[:, 0], horizon_px=horizon_px, deviation=zeros)
