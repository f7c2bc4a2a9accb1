# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Priors of a pass before its images: where it begins, and how vehicles move.

The unknowns of a pass of n observations are its poses (s, a, b of each), then the n speeds along
the path, the two errors of the path's heading, the error of the road's crossfall and the n
accelerations: 5 n + 3 numbers.

Every motion model is a Gaussian prior over them.  *Cruising* and *steady*: the speed is a Wiener
process, with a small rate and with the paper's (2012, eq. 24).  *Changing speed*: the acceleration
is a Wiener process.  *Changing lanes*: in addition to the drift across the path (eq. 27) there is
a persistent lateral rate, an Ornstein-Uhlenbeck process.  Each model comes with a smooth ride,
where the height above the path stays within millimetres so that image rows give the range, and
with a rough ride, where the front also rises and sinks on its springs.  The evidence of the images
then decides between them.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Any, NamedTuple, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from ..core.compiled import kernel
from ..core.records import Array
from ..core.tracker_config import TrackerConfig
from ..estimation.gaussian import NormalEquations

Indices = NDArray[np.intp]

LEAST_RATE = 1e-3  # least noise rate of any process
_LEAST_CROSSFALL = 1e-6
LEAST_STAMP_ERROR_M = 1e-6  # keeps the equations solvable where stamps are exact
_RATE_WINDOW_S = 0.35  # lateral rates are slopes over this time before and after
_RATE_OBSERVATIONS = 3  # least number of observations for a lateral rate
_MOVING_MPS = 2.0  # below this speed a heading does not follow from motion


@dataclass(frozen=True, eq=False)
class PassPrior:
    """
    The prior of a pass before its observations.

    :param s_m: arc length of the front in its first pair, m.
    :param s_std_m: 1-sigma of that arc length, m.
    :param offset_m: (2,) offsets a, b at ``s_m`` of the ray through the front's centre in the
        first left view, which defines the centre, m.
    :param offset_slope: (2,) change of these offsets per metre of s.
    :param speed_mps: expected speed, m/s.
    :param speed_std_mps: 1-sigma of the speed, m/s.
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
    One motion model.

    :param share: prior probability.
    :param speed_rate_std: random walk of the speed, m/s/sqrt(s); None where the acceleration
        is a random walk instead.
    :param changes_lanes: whether there is also a persistent rate across the path.
    :param ride_std_m: 1-sigma of the height above the path, m.
    """

    share: float
    speed_rate_std: Optional[float]
    changes_lanes: bool
    ride_std_m: float


def motion_models(config: TrackerConfig) -> list[MotionModel]:
    """Return the motion models that a configuration allows for, at least one."""
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
    Indices of the unknowns of a pass.

    :param observations: number n of observations.
    """

    observations: int

    @property
    def poses(self) -> Indices:
        """Return the indices (n, 3) of s, a, b."""
        return np.arange(3 * self.observations).reshape(-1, 3)

    @property
    def speeds(self) -> Indices:
        """Return the indices (n,) of the speeds."""
        return 3 * self.observations + np.arange(self.observations)

    @property
    def accelerations(self) -> Indices:
        """Return the indices (n,) of the accelerations."""
        return self.steady + np.arange(self.observations)

    @property
    def heading_error(self) -> Indices:
        """Return the indices (2,) of the errors of the path's heading, across and up."""
        return 4 * self.observations + np.arange(2)

    @property
    def steady(self) -> int:
        """Return the number of unknowns without the accelerations, which come last."""
        return 4 * self.observations + 3

    @property
    def crossfall_error(self) -> int:
        """Return the index of the error of the road's crossfall."""
        return 4 * self.observations + 2

    @property
    def size(self) -> int:
        """Return the number of unknowns."""
        return 5 * self.observations + 3


class Processes(NamedTuple):
    """
    Standard deviations of the processes of a pass that are common to all motion models.

    Compiled loops take the last two from here, as they would not notice a changed constant of this
    module.

    :param stamp_std_s: of each stamp, s.
    :param jerk_rate: of the random walk of the acceleration, m/s^2/sqrt(s).
    :param acceleration_mps2: of the first acceleration, m/s^2.
    :param drift_across_m: of the drift across the path, m/sqrt(s).
    :param manoeuvre_across_m: of the drift due to a persistent rate over long times, m/sqrt(s).
    :param manoeuvre_s: correlation time of that rate, s.
    :param smooth_ride_m: 1-sigma of the height above the path on a smooth ride, independent in
        each pair, and of its drift on any ride, m/sqrt(s); the rest of a rougher ride are springs.
    :param springs_rad_s: natural frequency of bodies on their springs.
    :param least_rate: lower limit of all rates and of ``acceleration_mps2``.
    :param least_stamp_error_m: lower limit of the position error due to stamps, m.
    """

    stamp_std_s: float
    jerk_rate: float
    acceleration_mps2: float
    drift_across_m: float
    manoeuvre_across_m: float
    manoeuvre_s: float
    smooth_ride_m: float
    springs_rad_s: float
    least_rate: float = LEAST_RATE
    least_stamp_error_m: float = LEAST_STAMP_ERROR_M


class PassMotion:
    """
    The priors of a pass at the stamps of its observations.

    :param prior: prior of its beginning.
    :param config: rates of the random walks.
    :param stamp_std_s: 1-sigma of each stamp, s.
    """

    def __init__(self, prior: PassPrior, config: TrackerConfig, stamp_std_s: float) -> None:
        self.prior, self.config = prior, config
        self.processes = Processes(
            stamp_std_s, config.jerk_rate_std, config.acceleration_std_mps2,
            config.drift_across_std_m, config.manoeuvre_across_std_m, config.manoeuvre_across_s,
            config.smooth_ride_std_m, 2 * math.pi * config.ride_hz)
        self._begun = NormalEquations(0)  # cached; depends on the number of observations only

    def equations(self, times_s: Array, state: Array,
                  models: Sequence[MotionModel]) -> list[NormalEquations]:
        """
        Return the normal equations of the prior, for each motion model.

        The equations of a model without accelerations leave these unknowns out.

        :param times_s: (n,) stamps, s.
        :param state: (n, 4) s, a, b and speed to linearise at.
        :param models: motion models; parts that they share are computed once.
        """
        return normal_equations(
            self.beginning(len(times_s)), self.processes, times_s, state, models)

    def way_information(self, times_s: Array, state: Array, rate: float) -> Array:
        """
        Return the information (n - 1, n - 1) of distances between pairs, given the speeds, 1/m^2.

        :param rate: random walk of the speed, m/s/sqrt(s).
        """
        return np.asarray(np.linalg.inv(_way_covariance(
            self.processes, np.diff(times_s), np.abs(state[:, 3]), rate)))

    def beginning(self, observations: int) -> NormalEquations:
        """Return the normal equations of the pass's beginning and of its static unknowns."""
        p, at, noise = self.prior, StateIndex(observations), self.config.noise
        if len(self._begun.g) == at.size:
            return self._begun
        normal = self._begun = NormalEquations(at.size)
        normal.row([0], [1.0], p.s_m, p.s_std_m)
        for axis in (0, 1):
            slope = float(p.offset_slope[axis])
            rest = float(p.offset_m[axis]) - slope * p.s_m
            normal.row([1 + axis, 0], [1.0, -slope], rest, noise.gauge_std_m)
            normal.row([at.heading_error[axis]], [1.0], 0.0, float(p.heading_std_rad[axis]))
        normal.row([at.crossfall_error], [1.0], 0.0,
                   max(self.config.crossfall_std, _LEAST_CROSSFALL))
        normal.row([at.speeds[0]], [1.0], p.speed_mps, p.speed_std_mps)
        return normal


@dataclass(frozen=True, eq=False)
class PassMotions:
    """
    The priors of a pass under three assumptions about its stamps.

    :param assumed: with the 1-sigma assumed at present, which is larger while stamps are uneven.
    :param nominal: with the 1-sigma of correct stamps.
    :param exact: with stamps that have no error.
    """

    assumed: PassMotion
    nominal: PassMotion
    exact: PassMotion

    @classmethod
    def of(cls, prior: PassPrior, config: TrackerConfig,
           nominal_std_s: Optional[float] = None) -> PassMotions:
        """
        Return the priors with the stamps of a configuration.

        :param nominal_std_s: 1-sigma of correct stamps, s; None for that of ``config``.
        """
        assumed = PassMotion(prior, config, config.stamp_std_s)
        nominal = assumed if nominal_std_s is None else PassMotion(prior, config, nominal_std_s)
        return cls(assumed, nominal, PassMotion(prior, config, 0.0))

    @property
    def prior(self) -> PassPrior:
        """Return the prior of the beginning of the pass."""
        return self.assumed.prior

    def doubting(self, stamp_std_s: float) -> PassMotions:
        """Return the priors with another 1-sigma of the stamps assumed, s."""
        return replace(self, assumed=PassMotion(
            self.prior, self.assumed.config, stamp_std_s))

    def begun_at(self, prior: PassPrior) -> PassMotions:
        """Return the priors of a pass that begins otherwise, with the same stamps."""
        assumed, nominal, exact = (
            PassMotion(prior, motion.config, motion.processes.stamp_std_s)
            for motion in (self.assumed, self.nominal, self.exact))
        return PassMotions(assumed, nominal, exact)


def normal_equations(begun: NormalEquations, processes: Processes, times_s: Array, state: Array,
                     models: Sequence[MotionModel]) -> list[NormalEquations]:
    """Return :meth:`PassMotion.equations`, given those of the beginning of the pass."""
    along = {rate: _along(processes, times_s, state, rate)
             for rate in {m.speed_rate_std for m in models}}
    if len(times_s) < 2:
        beside = {(m.ride_std_m, m.changes_lanes): begun for m in models}
    else:
        up = {ride: _above(processes, times_s, state, ride)
              for ride in {m.ride_std_m for m in models}}
        across = {changes: _across(processes, times_s, state, changes)
                  for changes in {m.changes_lanes for m in models}}
        beside = {(m.ride_std_m, m.changes_lanes):
                  begun + up[m.ride_std_m] + across[m.changes_lanes] for m in models}
    steady = StateIndex(len(times_s)).steady
    whole = [beside[m.ride_std_m, m.changes_lanes] + along[m.speed_rate_std] for m in models]
    return [prior if m.speed_rate_std is None else prior.leading(steady)
            for m, prior in zip(models, whole)]


def _along(processes: Processes, times_s: Array, state: Array, rate: Optional[float]
           ) -> NormalEquations:
    """Return the equations of motion along the path; a rate of None means changing speed."""
    at = StateIndex(len(times_s))
    normal = NormalEquations(at.size)
    if rate is None:
        normal.row([at.accelerations[0]], [1.0], 0.0,
                   max(processes.acceleration_mps2, processes.least_rate))
    if at.observations > 1:
        dt, speed = np.diff(times_s), np.abs(state[:, 3])
        if rate is None:
            _changing_speed(normal, processes, dt, speed)
        else:
            _steady(normal, processes, dt, speed, rate)
    return normal


def _stamp_covariance(processes: Processes, speed_mps: Array) -> Array:
    """Return the covariance (n - 1, n - 1) of distances between stamps due to stamp errors."""
    step = np.diff(np.eye(len(speed_mps)), axis=0)
    error_m = np.maximum(processes.stamp_std_s * speed_mps, processes.least_stamp_error_m)
    return np.asarray(step @ np.diag(np.square(error_m)) @ step.T)


def _way_covariance(processes: Processes, dt: Array, speed_mps: Array, rate: float) -> Array:
    """Return the covariance (n - 1, n - 1) of distances, given the speeds, a Wiener process."""
    return np.asarray(np.diag(rate ** 2 * dt ** 3 / 12)
                      + _stamp_covariance(processes, speed_mps))


def _across(processes: Processes, times_s: Array, state: Array, changes_lanes: bool
            ) -> NormalEquations:
    """Return the equations of the drift across the path (eq. 27) and of lane changes."""
    moves = np.diag(max(processes.drift_across_m, processes.least_rate) ** 2 * np.diff(times_s))
    if changes_lanes:
        moves += persistent_moves(times_s, processes.manoeuvre_across_m, processes.manoeuvre_s)
    return _beside(state, 0, moves)


def _above(processes: Processes, times_s: Array, state: Array, ride_m: float
           ) -> NormalEquations:
    """
    Return the equations of the drift above the path (eq. 27).

    The road carries the vehicle, so it drifts little, but it bounces on its springs where the ride
    is rougher than a smooth one.
    """
    step = np.diff(np.eye(len(times_s)), axis=0)
    smooth_m = min(ride_m, processes.smooth_ride_m)
    drift = np.diag(max(smooth_m, processes.least_rate) ** 2 * np.diff(times_s))
    heights = smooth_m ** 2 * np.eye(len(times_s)) + (ride_m ** 2 - smooth_m ** 2) * bounce(
        processes.springs_rad_s * (times_s[:, None] - times_s))
    return _beside(state, 1, drift + step @ heights @ step.T)


def bounce(lag_rad: Array) -> Array:
    """
    Return the correlation of heights of a body on its springs.

    It is that of a critically damped oscillator which white noise drives.  Real dampers are
    weaker, but their natural frequency is not known, so the phase of a bounce is soon lost.

    :param lag_rad: time between the heights times the natural frequency, rad.
    """
    apart = np.abs(lag_rad)
    return np.asarray((1 + apart) * np.exp(-apart))


def _beside(state: Array, axis: int, moves: Array) -> NormalEquations:
    """
    Return equations of moves across (axis 0) or above (1) the path, whose heading has an error.

    :param moves: (n - 1, n - 1) covariance of the moves, m^2.
    """
    n = len(state)
    at = StateIndex(n)
    normal, offsets = NormalEquations(at.size), at.poses[:, 1 + axis]
    ones, ds, da = np.ones(n - 1), np.diff(state[:, 0]), np.diff(state[:, 1])
    columns = np.column_stack([
        offsets[1:], offsets[:-1], np.full(n - 1, at.heading_error[axis]),
        np.full(n - 1, at.crossfall_error)])
    normal.correlated(columns, np.column_stack([ones, -ones, -ds, -da * axis]), moves)
    return normal


def persistent_moves(times_s: Array, across_std_m: float, persists_s: float) -> Array:
    """
    Return the covariance of the moves that result from an Ornstein-Uhlenbeck rate.

    The rate has the covariance r^2 exp(-|t - t'| / T), which is integrated over both intervals.
    Over long times the moves are those of a drift of sqrt(2 T) r.

    :param times_s: (n,) times of the observations, s.
    :param across_std_m: the drift sqrt(2 T) r, m/sqrt(s).
    :param persists_s: correlation time T, s.
    :return: (n - 1, n - 1), m^2.
    """
    dt = np.diff(times_s) / persists_s
    gaps = np.maximum(times_s[:-1] - times_s[1:, None], 0.0) / persists_s  # end to next start
    gaps += gaps.T
    fades = -np.expm1(-dt)
    covariance = np.outer(fades, fades) * np.exp(-gaps)
    np.fill_diagonal(covariance, 2 * (dt - fades))
    return np.asarray(0.5 * across_std_m ** 2 * persists_s * covariance)


def _steady(normal: NormalEquations, processes: Processes, dt: Array, speed_mps: Array,
            rate: float) -> None:
    """
    Add speed as a Wiener process.

    Given the speeds at both ends, the distance has the variance q dt^3 / 12 about that of their
    mean.
    """
    n = len(dt) + 1
    at = StateIndex(n)
    s, v = at.poses[:, 0], at.speeds
    rate = max(rate, processes.least_rate)
    ways = np.column_stack([np.ones(n - 1), -np.ones(n - 1), -dt / 2, -dt / 2])
    normal.correlated(np.column_stack([s[1:], s[:-1], v[:-1], v[1:]]), ways,
                      _way_covariance(processes, dt, speed_mps, rate))
    normal.rows(np.column_stack([v[1:], v[:-1]]), [1.0, -1.0], rate * np.sqrt(dt))


def walk_rate(rate: float) -> float:
    """Return the rate of a random walk, m/s/sqrt(s), not less than the least rate."""
    return max(rate, LEAST_RATE)


def _changing_speed(normal: NormalEquations, processes: Processes, dt: Array,
                    speed_mps: Array) -> None:
    """Add acceleration as a Wiener process, with distance, speed and acceleration correlated."""
    n = len(dt) + 1
    k, rate = np.arange(n - 1), max(processes.jerk_rate, processes.least_rate)
    at = StateIndex(n)
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
    covariance[np.ix_(k, k)] += _stamp_covariance(processes, speed_mps)
    normal.correlated(np.tile(columns, (3, 1)), np.vstack([ways, speeds, accelerations]),
                      covariance)


def lateral_rates(times_s: Array, offset_m: Array) -> Array:
    """
    Return the rates at which a front moves across its path.

    Each is the slope of a parabola fitted to the observations around it.  Differences of
    neighbours would lag by half an interval at the newest one, and be noisy at high frame rates.

    :param times_s: (n,) s.
    :param offset_m: (n,) offsets from the path, m.
    :return: (n,) m/s; 0 for a single observation.
    """
    n = len(times_s)
    if n < 3:
        return np.full(n, 0.0 if n < 2 else np.diff(offset_m)[0] / np.diff(times_s)[0])
    return slopes(times_s, np.ascontiguousarray(offset_m))


def rates_by_offsets(times_s: Array) -> Array:
    """Return the derivatives (n, n) of the rates of :func:`lateral_rates` by the offsets, 1/s."""
    return np.column_stack([lateral_rates(times_s, one) for one in np.eye(len(times_s))])


def plain_slopes(times_s: Array, offset_m: Array) -> Array:
    """Return the slopes (n,) of parabolas fitted to n >= 3 observations."""
    apart = times_s - times_s[:, None]  # row k: as seen from observation k
    nearest = np.sort(np.abs(apart), axis=1)
    reach = np.maximum(nearest[:, _RATE_OBSERVATIONS - 1], _RATE_WINDOW_S) + 1e-9
    t = np.where(np.abs(apart) <= reach[:, None], apart / reach[:, None], 0.0)
    inside = (np.abs(apart) <= reach[:, None]).astype(float)
    basis = np.stack([inside, t, t * t], axis=-1)  # (n, n, 3)
    normal = np.einsum('kji,kjl->kil', basis, basis)
    return np.asarray(np.linalg.solve(normal, (offset_m @ basis)[..., None])[:, 1, 0] / reach)


@kernel(plain_slopes, '(f8[::1], f8[::1])')
def slopes(times: Any, offsets: Any) -> Any:
    """Return the slopes; arguments are those of :func:`plain_slopes`."""
    n = len(times)
    out = np.empty(n)
    for k in range(n):
        nearest = np.sort(np.abs(times - times[k]))
        reach = max(nearest[_RATE_OBSERVATIONS - 1], _RATE_WINDOW_S) + 1e-9
        s0 = s1 = s2 = s3 = s4 = y0 = y1 = y2 = 0.0
        for j in range(n):
            if abs(times[j] - times[k]) <= reach:
                t = (times[j] - times[k]) / reach
                s0 += 1.0
                s1 += t
                s2 += t * t
                s3 += t * t * t
                s4 += t * t * t * t
                y0 += offsets[j]
                y1 += t * offsets[j]
                y2 += t * t * offsets[j]
        determinant = s0 * (s2 * s4 - s3 * s3) - s1 * (s1 * s4 - s3 * s2) + s2 * (
            s1 * s3 - s2 * s2)
        out[k] = (s0 * (y1 * s4 - y2 * s3) - y0 * (s1 * s4 - s3 * s2)
                  + s2 * (s1 * y2 - s2 * y1)) / determinant / reach
    return out


def headings(state: Array, rates_mps: Array, path_scale: Array) -> Array:
    """
    Return the headings of a vehicle that points in the direction of its motion.

    :param state: (n, 4) s, a, b, speed along the path.
    :param rates_mps: (n,) lateral rates.
    :param path_scale: (n,) metres travelled per metre of the path.
    :return: (n,) rad against the path; 0 at low speed.
    """
    along = np.abs(state[:, 3]) * path_scale
    return np.where(along > _MOVING_MPS, np.arctan2(rates_mps, along), 0.0)
