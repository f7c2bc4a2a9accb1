# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Motion models of the particles: along the environment (2010, Section IV), or free (GPF).

Both models draw the next states of particles; the likelihood and the rest of the filter are the
same.
"""
from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .boxes import Target
from .config import MonocularConfig
from .distance import DistanceField
from .dynamics import certainty, contour_rotation, contour_velocity
from .particles import Particles
from .perspective import perspective_growth
from .prior import accept_reject, Index, log_acceptance
from ..core.records import Array

_SMALLEST_PX = 3.0  # least side of a box; a smaller one has too few pixels to compare
_LARGEST_PX = 1e5  # largest side of a box, and largest coordinate of its reference point
_FARTHEST_HORIZON_PX = 1e7  # above the image; a farther horizon does not change the sizes
_MOST_LOG_GROWTH = 20.0  # of the log size between frames, so that its exponential is finite
_STANDING = 0.3  # a target slower than this share of the initial velocity's spread stands
_SPIN_SHARE = 0.2  # share of the angle noise that enters its rate; the rest enters the angle
_LEAST_CERTAINTY = 0.2  # least certainty of the contour; bounds the prior's width on ridges


class ParticleMotion(Protocol):
    """Motion of particles from one used frame to the next."""

    def start(self, particles: Particles) -> Particles:
        """Complete the initial particles of a target."""

    def move(self, particles: Particles, frames: float,
             rng: np.random.Generator) -> tuple[Particles, Array]:
        """
        Draw the next states.

        :param frames: time to the next frame used, frames of the video.
        :return: the particles, and the logarithms (N,) of their importance weights.
        """


class PlainMotion:
    """
    Constant rates of position, size and angle, with noise: the paper's baseline, GPF.

    :param upright: whether the box never rotates.
    """

    def __init__(self, config: MonocularConfig, upright: bool) -> None:
        self.config, self.upright = config, upright

    def start(self, particles: Particles) -> Particles:
        """Return the particles as they are."""
        return particles

    def move(self, particles: Particles, frames: float,
             rng: np.random.Generator) -> tuple[Particles, Array]:
        """Draw the next states; see :class:`ParticleMotion`."""
        c, count, root = self.config, len(particles), np.sqrt(frames)
        velocity, _ = stop_and_start(particles, frames, c, rng)
        velocity, point = scattered(particles, velocity, frames, c, rng, np.arange(count))
        rate = particles.size_rate + c.size_rate_noise * root * rng.standard_normal((count, 2))
        log_size = rate * frames + c.size_noise * root * rng.standard_normal((count, 2))
        spin, angle = particles.spin_rad, particles.angle_rad
        if not self.upright:
            noise = np.radians(c.angle_noise_deg) * root * rng.standard_normal((count, 2))
            spin = spin + _SPIN_SHARE * noise[:, 0]
            angle = angle + spin * frames + noise[:, 1]
        growth = np.exp(np.clip(log_size, -_MOST_LOG_GROWTH, _MOST_LOG_GROWTH))
        size = np.clip(particles.size_px * growth, _SMALLEST_PX, _LARGEST_PX)
        return replace(particles, point_px=point, velocity_px=velocity, size_px=size,
                       size_rate=rate, angle_rad=angle, spin_rad=spin), np.zeros(count)


class EnvironmentMotion:
    """
    Motion along the contours, kept at likely distances, with sizes from the perspective.

    An upright object stands on the ground: its box never rotates, and its size follows from the
    row of its foot. Other objects rotate with the contour and keep their size.

    :param field: the environment.
    :param config: parameters.
    :param target: the target, as marked.
    """

    def __init__(self, field: DistanceField, config: MonocularConfig, target: Target) -> None:
        self.field, self.config, self.upright = field, config, target.upright
        self.initial_size_px = np.asarray(target.box_px[2:], dtype=np.float64)
        self.initial_foot_px = float(target.box_px[1] + target.box_px[3])

    def start(self, particles: Particles) -> Particles:
        """Return the particles with the distance rates that follow from their velocities."""
        return replace(particles, distance_rate_px=self._rate(
            particles.point_px + particles.velocity_px, particles.velocity_px, 1.0))

    def move(self, particles: Particles, frames: float,
             rng: np.random.Generator) -> tuple[Particles, Array]:
        """Draw the next states; see :class:`ParticleMotion`."""
        f, c = self.field, self.config
        velocity, new = stop_and_start(particles, frames, c, rng)
        rate = particles.distance_rate_px.copy()
        rate[new] = self._rate(particles.point_px[new] + velocity[new], velocity[new], 1.0)
        particles = replace(particles, velocity_px=velocity, distance_rate_px=rate)
        velocity = contour_velocity(f, particles.point_px, particles.velocity_px,
                                    particles.distance_rate_px, frames)
        level, gradient = f.level_and_gradient(particles.point_px)
        expected = level + particles.distance_rate_px * frames
        std = c.prior_noise * particles.scale_px * frames / np.maximum(
            certainty(gradient), _LEAST_CERTAINTY)

        def propose(index: Index) -> Array:
            return np.concatenate(
                scattered(particles, velocity, frames, c, rng, index), axis=-1)

        def log_chance(index: Index, drawn: Array) -> Array:
            return log_acceptance(f.distance(drawn[:, 2:]), expected[index], std[index])

        drawn, log_weights = accept_reject(propose, log_chance, len(particles), c.prior_rounds,
                                           rng)
        moved = self._completed(particles, drawn[:, :2], drawn[:, 2:], frames, rng)
        return moved, log_weights

    def _completed(self, old: Particles, velocity: Array, point: Array, frames: float,
                   rng: np.random.Generator) -> Particles:
        """Draw the remaining state variables, given positions and velocities."""
        c, count, root = self.config, len(old), np.sqrt(frames)
        rate = self._rate(point, velocity, frames)
        # sizes vary about the perspective values without drifting away
        keep = np.exp(-frames / c.spread_frames)
        spread = np.array([c.width_spread, c.height_spread]) * np.sqrt(1 - keep ** 2)
        deviation = keep * old.deviation + spread * rng.standard_normal((count, 2))
        size = self.initial_size_px * np.exp(deviation)
        horizon, angle = old.horizon_px, old.angle_rad
        if self.upright:
            foot = point[:, 1]
            growth = perspective_growth(old.point_px[:, 1], foot, horizon)
            velocity, rate = velocity * growth[:, None], rate * growth
            horizon = foot - (foot - horizon) * np.exp(
                c.horizon_noise * root * rng.standard_normal(count))
            # above the particle's foot and that of the initial box
            horizon = np.clip(horizon, -_FARTHEST_HORIZON_PX,
                              np.minimum(self.initial_foot_px, foot) - _SMALLEST_PX)
            size = size * ((foot - horizon) / (self.initial_foot_px - horizon))[:, None]
        else:
            angle = angle + contour_rotation(self.field, old.point_px, point) + np.radians(
                c.angle_noise_deg) * root * rng.standard_normal(count)
        return replace(old, point_px=point, velocity_px=velocity, horizon_px=horizon,
                       size_px=np.clip(size, _SMALLEST_PX, _LARGEST_PX), angle_rad=angle,
                       distance_rate_px=rate, deviation=deviation)

    def _rate(self, point: Array, velocity: Array, frames: float) -> Array:
        """Return the rate (N,) of the distance over the last step, without position noise."""
        before = self.field.level(point - velocity * frames)
        return np.asarray((self.field.level(point) - before) / frames)


def stop_and_start(particles: Particles, frames: float, config: MonocularConfig,
                   rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
    """
    Let some moving particles stop, and some standing ones start again.

    The noise of eq. 19 covers neither; a new velocity is drawn as for a new target.

    :return: velocities (N, 2), px per frame, and a mask (N,) of the changed ones.
    """
    count, scale = len(particles), particles.scale_px
    speed = np.hypot(particles.velocity_px[:, 0], particles.velocity_px[:, 1])
    stands = speed < _STANDING * config.start_speed * scale
    chance = np.where(stands, config.start_chance, config.stop_chance)
    new = rng.random(count) < 1.0 - (1.0 - chance) ** frames
    fresh = config.start_speed * scale[:, None] * rng.standard_normal((count, 2))
    return np.where(new[:, None], np.where(stands[:, None], fresh, 0.0),
                    particles.velocity_px), new


def scattered(particles: Particles, velocity_px: Array, frames: float,
              config: MonocularConfig, rng: np.random.Generator,
              index: Index) -> tuple[Array, Array]:
    """
    Draw velocities and positions around the expected ones (eq. 19).

    :param velocity_px: (N, 2) expected velocities of all particles.
    :param index: (n,), the particles to draw for.
    :return: (n, 2) velocities and (n, 2) points.
    """
    noise = particles.scale_px[index, None, None] * np.sqrt(frames) * rng.standard_normal(
        (len(index), 2, 2))
    velocity = velocity_px[index] + config.velocity_noise * noise[:, 0]
    point = particles.point_px[index] + velocity * frames + config.position_noise * noise[:, 1]
    return velocity, np.clip(point, -_LARGEST_PX, _LARGEST_PX)
