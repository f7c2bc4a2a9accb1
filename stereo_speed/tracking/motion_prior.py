# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What is known of a pass without its images: where it begins, and how vehicles move.

The unknowns of a pass of n observations are its poses (s, a, b of each), then the relief of the
front at its m nodes, the n speeds along the path, the n accelerations and the two errors of the
heading of the path: 5 n + m + 2 numbers.

Every model of motion is a Gaussian prior over them.  *Cruising* and *steady*: the speed is a
Wiener process, of a small rate and of the paper's (2012, eq. 24).  *Changing speed*: the
acceleration is one.  *Changing lanes*: beside the drift across the path (eq. 27) there is a rate
that persists, an Ornstein-Uhlenbeck process.  Each on a smooth ride, where the height above the
path is known to millimetres and so the rows of the images tell the range, or on a rough one.  The
images then say which it was, by their evidence.
"""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from ..core.config import TrackerConfig
from ..core.records import Array
from ..estimation.gaussian import NormalEquations

Indices = NDArray[np.intp]

_LEAST_RATE = 1e-3  # no process is noiseless
_LEAST_STAMP_ERROR_M = 1e-6  # nor is a way known better, or the equations cannot be solved
_UNUSED_STD = 1.0  # of accelerations in a model that has none; its value has no effect
_RATE_WINDOW_S = 0.35  # lateral rates are slopes over this time either way
_RATE_OBSERVATIONS = 3  # a lateral rate comes from this many observations at least
_MOVING_MPS = 2.0  # what is slower has no heading of its own


@dataclass(frozen=True, eq=False)
class PassPrior:
    """
    What is known of a pass before its observations.

    :param s_m: arc length of the front in its first pair, m, and
    :param s_std_m: its 1-sigma.
    :param offset_m: (2,) offsets a, b at ``s_m`` of the ray through the front's centre in the
        first left view, which defines the centre, m.
    :param offset_slope: (2,) their change per metre of s.
    :param speed_mps: expected speed, m/s, and
    :param speed_std_mps: its 1-sigma.
    :param heading_std_rad: (2,) 1-sigma of the path's heading across and up.
    """

    s_m: float
    s_std_m: float
    offset_m: Array
    offset_slope: Array
    speed_mps: float
    speed_std_mps: float
    heading_std_rad: Array


@dataclass(frozen=True)
class MotionModel:
    """
    One way to drive.

    :param share: prior probability.
    :param speed_rate_std: random walk of the speed, m/s/sqrt(s); None where the acceleration
        is one.
    :param changes_lanes: whether it also has a rate across the path that persists.
    :param ride_std_m: bouncing above the path, m, and climbing, m/sqrt(s).
    """

    share: float
    speed_rate_std: Optional[float]
    changes_lanes: bool
    ride_std_m: float


def motion_models(config: TrackerConfig) -> list[MotionModel]:
    """Return the models of motion that a configuration allows for, at least one."""
    p, c = config.manoeuvre_probability, config
    drives = (((1 - p) ** 2 * c.cruise_share, c.cruise_rate_std, False),
              ((1 - p) ** 2 * (1 - c.cruise_share), c.speed_rate_std, False),
              (p * (1 - p), None, False),
              (p * (1 - p), c.speed_rate_std, True),
              (p * p, None, True))
    rides = ((c.smooth_share, c.smooth_ride_std_m), (1 - c.smooth_share, c.rough_ride_std_m))
    models = [MotionModel(share * ride_share, rate, changes, ride_std)
              for share, rate, changes in drives for ride_share, ride_std in rides]
    return [m for m in models if m.share > 0]


@dataclass(frozen=True)
class StateIndex:
    """
    Where the unknowns of a pass are.

    :param observations: their number n.
    :param nodes: number m of the relief's nodes.
    """

    observations: int
    nodes: int

    @property
    def poses(self) -> Indices:
        """Return the indices (n, 3) of s, a, b."""
        return np.arange(3 * self.observations).reshape(-1, 3)

    @property
    def relief(self) -> Indices:
        """Return the indices (m,) of the relief."""
        return 3 * self.observations + np.arange(self.nodes)

    @property
    def speeds(self) -> Indices:
        """Return the indices (n,) of the speeds."""
        return 3 * self.observations + self.nodes + np.arange(self.observations)

    @property
    def accelerations(self) -> Indices:
        """Return the indices (n,) of the accelerations."""
        return self.speeds + self.observations

    @property
    def heading_error(self) -> Indices:
        """Return the indices (2,) of the errors of the path's heading, across and up."""
        return 5 * self.observations + self.nodes + np.arange(2)

    @property
    def size(self) -> int:
        """Return the number of unknowns."""
        return 5 * self.observations + self.nodes + 2


class PassMotion:
    """
    The priors of a pass at the stamps of its observations.

    :param prior: how it begins.
    :param config: rates of the random walks.
    :param stamp_std_s: 1-sigma of each stamp, s.
    :param nodes: number of nodes of the front's relief.
    """

    def __init__(self, prior: PassPrior, config: TrackerConfig, stamp_std_s: float,
                 nodes: int) -> None:
        self.prior, self.config, self.stamp_std_s = prior, config, stamp_std_s
        self.nodes = nodes
        self._begun = NormalEquations(0)  # the same for each number of observations

    def equations(self, times_s: Array, state: Array,
                  models: Sequence[MotionModel]) -> list[NormalEquations]:
        """
        Return all that is known without the images, for each way to drive.

        :param times_s: (n,) stamps, s.
        :param state: (n, 4) s, a, b and speed as known so far; for what is not linear.
        :param models: ways to drive; what they share is made once.
        """
        if len(self._begun.g) != StateIndex(len(times_s), self.nodes).size:
            self._begun = self._beginning(len(times_s))
        common = self._begun
        if len(times_s) < 2:
            return [common + self._along(times_s, state, m.speed_rate_std) for m in models]
        up = {ride: common + self._above(times_s, state, ride)
              for ride in {m.ride_std_m for m in models}}
        across = {changes: self._across(times_s, state, changes)
                  for changes in {m.changes_lanes for m in models}}
        along = {rate: self._along(times_s, state, rate)
                 for rate in {m.speed_rate_std for m in models}}
        return [up[m.ride_std_m] + across[m.changes_lanes] + along[m.speed_rate_std]
                for m in models]

    def _beginning(self, observations: int) -> NormalEquations:
        """Return how the pass begins, and what is static in it."""
        p, at, noise = self.prior, StateIndex(observations, self.nodes), self.config.noise
        normal = NormalEquations(at.size)
        normal.row([0], [1.0], p.s_m, p.s_std_m)
        for axis in (0, 1):
            slope = float(p.offset_slope[axis])
            rest = float(p.offset_m[axis]) - slope * p.s_m
            normal.row([1 + axis, 0], [1.0, -slope], rest, noise.gauge_std_m)
            normal.row([at.heading_error[axis]], [1.0], 0.0, float(p.heading_std_rad[axis]))
        normal.rows(at.relief[:, None], [1.0], np.full(self.nodes, noise.relief_std_m))
        normal.row([at.speeds[0]], [1.0], p.speed_mps, p.speed_std_mps)
        return normal

    def _along(self, times_s: Array, state: Array, rate: Optional[float]) -> NormalEquations:
        """Return the motion along the path; a rate of None is a changing speed."""
        at = StateIndex(len(times_s), self.nodes)
        normal = NormalEquations(at.size)
        if rate is None:
            normal.row([at.accelerations[0]], [1.0], 0.0,
                       max(self.config.acceleration_std_mps2, _LEAST_RATE))
        else:
            normal.rows(at.accelerations[:, None], [1.0], np.full(at.observations, _UNUSED_STD))
        if at.observations > 1:
            dt, speed = np.diff(times_s), np.abs(state[:, 3])
            if rate is None:
                _changing_speed(self, normal, dt, speed)
            else:
                _steady(self, normal, dt, speed, rate)
        return normal

    def stamp_covariance(self, speed_mps: Array) -> Array:
        """Return the covariance (n - 1, n - 1) of ways between stamps that are wrong."""
        step = np.diff(np.eye(len(speed_mps)), axis=0)
        error_m = np.maximum(self.stamp_std_s * speed_mps, _LEAST_STAMP_ERROR_M)
        return np.asarray(step @ np.diag(np.square(error_m)) @ step.T)

    def _across(self, times_s: Array, state: Array, changes_lanes: bool) -> NormalEquations:
        """Return the drift across the path (eq. 27), and the rate of a change of lanes."""
        c, dt = self.config, np.diff(times_s)
        moves = np.diag(max(c.drift_across_std_m, _LEAST_RATE) ** 2 * dt)
        if changes_lanes:
            moves += persistent_moves(times_s, c.manoeuvre_across_std_m, c.manoeuvre_across_s)
        return self._beside(state, 0, moves)

    def _above(self, times_s: Array, state: Array, ride_m: float) -> NormalEquations:
        """
        Return the drift above the path (eq. 27).

        The road carries the vehicle: it drifts little, and bounces on its springs.
        """
        step = np.diff(np.eye(len(times_s)), axis=0)
        drift = np.diag(max(ride_m, _LEAST_RATE) ** 2 * np.diff(times_s))
        return self._beside(state, 1, drift + ride_m ** 2 * step @ step.T)

    def _beside(self, state: Array, axis: int, moves: Array) -> NormalEquations:
        """
        Return moves across (axis 0) or above (1) the path, whose own heading has an error.

        :param moves: (n - 1, n - 1) their covariance, m^2.
        """
        n = len(state)
        at = StateIndex(n, self.nodes)
        normal, offsets = NormalEquations(at.size), at.poses[:, 1 + axis]
        ones, ds = np.ones(n - 1), np.diff(state[:, 0])
        heading_error = np.full(n - 1, at.heading_error[axis])
        columns = np.column_stack([offsets[1:], offsets[:-1], heading_error])
        normal.correlated(columns, np.column_stack([ones, -ones, -ds]), moves)
        return normal


def persistent_moves(times_s: Array, across_std_m: float, persists_s: float) -> Array:
    """
    Return the covariance of the moves that an Ornstein-Uhlenbeck rate makes.

    The rate has the covariance r^2 exp(-|t - t'| / T); integrated over both intervals.  Over long
    times the moves are those of a drift of sqrt(2 T) r.

    :param times_s: (n,) times of the observations, s.
    :param across_std_m: that drift, m/sqrt(s).
    :param persists_s: T, s.
    :return: (n - 1, n - 1), m^2.
    """
    dt = np.diff(times_s) / persists_s
    gaps = np.maximum(times_s[:-1] - times_s[1:, None], 0.0) / persists_s  # end to next start
    gaps += gaps.T
    fades = -np.expm1(-dt)
    covariance = np.outer(fades, fades) * np.exp(-gaps)
    np.fill_diagonal(covariance, 2 * (dt - fades))
    return np.asarray(0.5 * across_std_m ** 2 * persists_s * covariance)


def _steady(motion: PassMotion, normal: NormalEquations, dt: Array, speed_mps: Array,
            rate: float) -> None:
    """
    Add speed as a Wiener process.

    Given both ends, the way between them scatters by q dt^3 / 12 about their mean.
    """
    n = len(dt) + 1
    at = StateIndex(n, motion.nodes)
    s, v = at.poses[:, 0], at.speeds
    rate = max(rate, _LEAST_RATE)
    ways = np.column_stack([np.ones(n - 1), -np.ones(n - 1), -dt / 2, -dt / 2])
    normal.correlated(np.column_stack([s[1:], s[:-1], v[:-1], v[1:]]), ways,
                      np.diag(rate ** 2 * dt ** 3 / 12) + motion.stamp_covariance(speed_mps))
    normal.rows(np.column_stack([v[1:], v[:-1]]), [1.0, -1.0], rate * np.sqrt(dt))


def _changing_speed(motion: PassMotion, normal: NormalEquations, dt: Array,
                    speed_mps: Array) -> None:
    """Add acceleration as a Wiener process; way, speed and acceleration scatter together."""
    n = len(dt) + 1
    k, rate = np.arange(n - 1), max(motion.config.jerk_rate_std, _LEAST_RATE)
    at = StateIndex(n, motion.nodes)
    s, v, a = at.poses[:, 0], at.speeds, at.accelerations
    zero, one = np.zeros(n - 1), np.ones(n - 1)
    columns = np.column_stack([s[1:], s[:-1], v[1:], v[:-1], a[1:], a[:-1]])
    ways = np.column_stack([one, -one, zero, -dt, zero, -dt ** 2 / 2])
    speeds = np.column_stack([zero, zero, one, -one, zero, -dt])
    accelerations = np.column_stack([zero, zero, zero, zero, one, -one])
    moments = ((dt ** 5 / 20, dt ** 4 / 8, dt ** 3 / 6),
               (dt ** 4 / 8, dt ** 3 / 3, dt ** 2 / 2),
               (dt ** 3 / 6, dt ** 2 / 2, dt))
    covariance = rate ** 2 * np.block([[np.diag(m) for m in row] for row in moments])
    covariance[np.ix_(k, k)] += motion.stamp_covariance(speed_mps)
    normal.correlated(np.tile(columns, (3, 1)), np.vstack([ways, speeds, accelerations]),
                      covariance)


def lateral_rates(times_s: Array, offset_m: Array) -> Array:
    """
    Return the rates at which a front moves across its path.

    Each is the slope there of a parabola through the observations around it; differences of
    neighbours would be late by half an interval at the newest one, and noisy at high frame rates.

    :param times_s: (n,) s.
    :param offset_m: (n,) offsets from the path, m.
    :return: (n,) m/s; 0 for a single observation.
    """
    n = len(times_s)
    if n < 3:
        return np.full(n, 0.0 if n < 2 else np.diff(offset_m)[0] / np.diff(times_s)[0])
    apart = times_s - times_s[:, None]  # row k: as seen from observation k
    nearest = np.sort(np.abs(apart), axis=1)
    reach = np.maximum(nearest[:, _RATE_OBSERVATIONS - 1], _RATE_WINDOW_S) + 1e-9
    t = np.where(np.abs(apart) <= reach[:, None], apart / reach[:, None], 0.0)
    inside = (np.abs(apart) <= reach[:, None]).astype(float)
    basis = np.stack([inside, t, t * t], axis=-1)  # (n, n, 3)
    normal = np.einsum('kji,kjl->kil', basis, basis)
    return np.asarray(np.linalg.solve(normal, (offset_m @ basis)[..., None])[:, 1, 0] / reach)


def headings(state: Array, rates_mps: Array, path_scale: Array) -> Array:
    """
    Return the headings of a vehicle that drives where it points.

    :param state: (n, 4) s, a, b, speed along the path.
    :param rates_mps: (n,) lateral rates.
    :param path_scale: (n,) metres travelled per metre of the path.
    :return: (n,) rad against the path; 0 for what hardly moves.
    """
    along = np.abs(state[:, 3]) * path_scale
    return np.array([math.atan2(rate, speed) if speed > _MOVING_MPS else 0.0
                     for rate, speed in zip(rates_mps, along)])
