# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The path-constrained stereo particle filter of the 2012 paper, made to work at real ranges.

The paper's elements: particles over the place of the front on the road's path and its speed
(eq. 24, 25-27), the likelihood of both views and across them (eq. 12-18), the adaptive reference
(eq. 14), resampling, posterior mean and covariance (eq. 3).  What is added: after each pair the
particles, which find the vehicle but are metres apart at range, are moved by the photometric
refinement of the whole pass (``refine``) so that their mean and covariance are those of all
images so far; depth and offsets stay unknowns instead of dying in the first pairs.
"""
from __future__ import annotations

from dataclasses import replace
import math
from typing import Optional, Union

import numpy as np

from .front import Front, turned
from .initialise import place_front, Placement
from .likelihood import Reference, score
from .motion_prior import PassPrior
from .observation import inside, lag_s, ObservationSampler
from .pass_result import calibration_share, conclude, live_std, Pass
from .protocol import Refusal, TrackStart
from .window import PhotometricWindow, Posterior
from ..core.config import NoParameters, TrackerConfig
from ..core.records import (
    Array, PassResult, StereoPair, TrackEnd, TrackState, TrackUpdate)
from ..estimation.particle_filter import weigh
from ..estimation.resampling import systematic
from ..estimation.weights import (
    DegenerateWeightsError, mean_and_covariance, normalise_log_weights)
from ..vision.haar import CELLS, PartGrid

_JITTER = 1e-12
_DISTINCT_PER_DIM = 3


class ConstrainedTracker:
    """
    Follow one vehicle along the path of its lane; see the module's docstring.

    :param start: what the track starts from.
    :param placed: where its first front stands.
    :param grid: samples of the front.
    """

    Settings = NoParameters  # its parameters are those that all trackers share

    @classmethod
    def start(cls, start: TrackStart,
              settings: NoParameters) -> Union[ConstrainedTracker, Refusal]:
        """Return a tracker that follows a front, or the reason why it cannot."""
        grid = PartGrid(start.config.parts, start.config.samples_per_part)
        placed = place_front(start, grid)
        return placed if isinstance(placed, Refusal) else cls(start, placed, grid)

    def __init__(self, start: TrackStart, placed: Placement, grid: PartGrid) -> None:
        self.rig, self.lane, self.config = start.rig, start.lane, start.config
        self.track, self.rng = start.track, start.rng
        self.grid = PartGrid(self.config.parts, CELLS)
        self.expected_mps = start.expected_mps
        self.front: Front = placed.front
        sampler = ObservationSampler(
            self.rig, placed.front, grid.unit_xy, grid.shape, self.config.trigger_tolerance_s)
        prior = PassPrior(
            s_m=float(placed.pose[0]), s_std_m=placed.s_std_m, offset_m=placed.pose[1:],
            offset_slope=placed.offset_slope, speed_mps=self.expected_mps,
            speed_std_mps=2 * self.config.initial_speed_std * self.expected_mps,
            heading_std_rad=np.asarray(self.lane.heading_std_rad))
        self.refiner = PhotometricWindow(sampler, prior, self.config)
        self.particles = self._first_particles(
            placed.pose, placed.offset_slope,
            self.config.noise.start_std_px / abs(placed.disparity_slope))
        self.log_weights = np.zeros(self.config.particles)
        self.posterior: Optional[Posterior] = None
        self.reference: Optional[Reference] = None
        self.first_ns = self.last_ns = self.seen_ns = start.pair.stamp_ns
        self.stamps_ns: list[int] = []  # of the pairs it was seen in
        self.width_px = 0.0
        self._told: Optional[TrackUpdate] = None
        self._end: Optional[TrackEnd] = None

    @property
    def ended(self) -> bool:
        """Whether the pass is over: out of view, or lost for too long."""
        return self._end is not None

    def share(self, particles: int) -> None:
        """Go on with another number of particles, when tracks come and go."""
        if particles != len(self.particles):
            weights = normalise_log_weights(self.log_weights)
            self.particles = self.particles[systematic(weights, particles, self.rng)]
            self.log_weights = np.zeros(particles)

    def update(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """Predict, weigh, resample, refine (2012, Section III)."""
        if self._end:
            return None
        self._predict((pair.stamp_ns - self.last_ns) * 1e-9)
        self.last_ns = pair.stamp_ns
        if self._out_of_view():
            self._end = TrackEnd.LEFT_VIEW
            return None
        predicted, last = (self.particles.copy(), self.log_weights.copy()), self._told
        posterior = self._refine(pair) if self._weigh(pair) else None
        if posterior is None:
            self.particles, self.log_weights = predicted
        else:
            self.posterior, self.seen_ns = posterior, pair.stamp_ns
        if posterior is None or not posterior.clear[-1]:
            if self._is_lost(pair.stamp_ns):
                self._end = TrackEnd.LOST
                return None
            return self._report(pair, TrackState.COASTING)
        self.stamps_ns.append(pair.stamp_ns)
        self._update_reference(pair)
        # What braked out of sight shows its speed only in the second pair that it is seen in.
        confirmed = len(self.stamps_ns) >= self.config.visibility.confirm_pairs and not _coasts(last)
        update = self._report(pair, TrackState.CONFIRMED if confirmed else TrackState.TENTATIVE)
        if last is not None and not may_follow(update, last, self.config):
            return replace(update, state=TrackState.TENTATIVE)
        return update

    def result(self) -> PassResult:
        """Measure the pass from all its pairs, or say why it cannot be measured."""
        seen = bool(self.stamps_ns)
        posterior = self.refiner.finish() if seen else None
        stamps_ns = [ns for ns in self.stamps_ns if ns not in self.refiner.hidden]
        found = Pass(track=self.track, lane=self.lane, stamps_ns=stamps_ns or [self.first_ns],
                     posterior=posterior,
                     exact_speeds=self.refiner.exact_speeds() if seen else None,
                     width_px=self.width_px, end=self._end or TrackEnd.STREAM_ENDED)
        return conclude(found, self.rig, self.config)

    # -- the filter's steps ---------------------------------------------------------------

    def _first_particles(self, pose: Array, slope: Array, s_std_m: float) -> Array:
        """Particles (N, 4) of s, a, b, v on the ray of the front's centre, any likely speed."""
        n, limit = self.config.particles, self.expected_mps
        ds = s_std_m * self.rng.standard_normal(n)
        speed = limit * (1 + self.config.initial_speed_std * self.rng.standard_normal(n))
        # A quarter of the particles cover what limits do not foresee.
        speed[: n // 4] = self.rng.uniform(0.0, 2.5 * limit, n // 4)
        return np.column_stack([pose[0] + ds, pose[1:] + ds[:, None] * slope,
                                np.maximum(speed, 0.0)])

    def _predict(self, dt_s: float) -> None:
        """Random-walk speed along the path, drift across and above it (eq. 24, 25, 27)."""
        if dt_s <= 0:
            return
        c, n, root = self.config, len(self.particles), np.sqrt(dt_s)
        s, a, b, v = self.particles.T
        noise = self.rng.standard_normal((4, n)) * root
        v_next = v + c.speed_rate_std * noise[3]
        self.particles = np.column_stack([
            s + 0.5 * (v + v_next) * dt_s,
            a + self._lateral_mps() * dt_s + c.drift_across_std_m * noise[1],
            b + c.drift_up_std_m * noise[2], v_next])

    def _weigh(self, pair: StereoPair) -> bool:
        """Weigh by the images (eq. 2, 12) and resample; False when none is possible."""
        quads = self._quads(self.particles, lag_s(pair, self.config.trigger_tolerance_s))
        scores = score(pair.left, pair.right, quads, self.reference, grid=self.grid,
                       config=self.config)
        try:
            weighed = weigh(self.log_weights, scores.log_likelihood, self.config.resample_ess,
                            self.rng)
        except DegenerateWeightsError:
            return False
        self.particles = self.particles[weighed.ancestors]
        self.log_weights = weighed.log_weights
        return True

    def _refine(self, pair: StereoPair) -> Optional[Posterior]:
        """
        Move the particles to the posterior of all images so far.

        A look that is hidden in part leads them, but leaves no trace in later ones.

        :return: None when the vehicle is not seen.
        """
        weights = normalise_log_weights(self.log_weights)
        guess, cov = mean_and_covariance(weights, self.particles)
        posterior = self.refiner.add(pair, guess, again=_coasts(self._told))
        if posterior is None:
            return None
        if not posterior.clear[-1]:
            self.refiner.drop_last()
        if not posterior.seen[-1]:
            return None
        self.particles = _transport(self.particles, (guess, cov), posterior.at(-1), self.rng)
        return posterior

    def _update_reference(self, pair: StereoPair) -> None:
        """Blend the features at the estimated state into the reference (eq. 14)."""
        quads = self._quads(self._mean()[None], lag_s(pair, self.config.trigger_tolerance_s))
        at = score(pair.left, pair.right, quads, None, grid=self.grid, config=self.config)
        if self.reference is None:
            self.reference = Reference(at.left[0], at.right[0])
        else:
            self.reference = self.reference.updated(
                at.left[0], at.right[0], self.config.reference_epsilon)

    # -- what is told ---------------------------------------------------------------------

    def _lateral_mps(self) -> float:
        """Rate at which the vehicle crosses its path, from all looks so far."""
        return 0.0 if self.posterior is None else float(self.posterior.lateral_mps[-1])

    def _heading_rad(self) -> float:
        """Heading of the vehicle against its path: it drives where it points."""
        return 0.0 if self.posterior is None else float(self.posterior.heading_rad[-1])

    def _quads(self, states: Array, lag_s: float = 0.0) -> tuple[Array, Array]:
        """Corners of the front at states (N, 4) of s, a, b, v, in the left and the right view."""
        later = None
        if lag_s:
            rate = np.full(len(states), self._lateral_mps())
            later = states[:, :3] + lag_s * np.column_stack([states[:, 3], rate, 0 * rate])
        return self.front.corners(self.rig, states[:, :3], self._heading_rad(), later)

    def _mean(self) -> Array:
        return normalise_log_weights(self.log_weights) @ self.particles

    def _is_lost(self, now_ns: int) -> bool:
        limits = self.config.visibility
        whole_ns = self.stamps_ns[-1] if self.stamps_ns else self.first_ns
        return (now_ns - self.seen_ns) * 1e-9 > limits.lost_after_s \
            or (now_ns - whole_ns) * 1e-9 > limits.occluded_for_s

    def _out_of_view(self) -> bool:
        mean, limits = self._mean(), self.config.visibility
        left, right = self._quads(mean[None])
        if self.stamps_ns and np.ptp(left[0, :, 0]) < limits.least_width_px or \
                mean[0] > self.lane.path.length_m + limits.beyond_path_m:
            return True
        return not (inside(self.rig.left, left[0]) and inside(self.rig.right, right[0]))

    def _report(self, pair: StereoPair, state: TrackState) -> TrackUpdate:
        mean, cov = mean_and_covariance(normalise_log_weights(self.log_weights), self.particles)
        frame = self.lane.path.frame(np.array(mean[0]))
        left, right = self._quads(mean[None])
        if state is not TrackState.COASTING:
            self.width_px = max(self.width_px, float(np.ptp(left[0, :, 0])))
        ground = self.front.ground_speed(mean[:3], float(mean[3]), self._lateral_mps())
        ratio = ground / mean[3] if mean[3] else 1.0
        share = calibration_share(self.rig, self.lane, self.config, float(mean[0]))
        std = live_std(float(ratio * np.sqrt(cov[3, 3])), ground, share)
        self._told = TrackUpdate(
            stamp_ns=pair.stamp_ns, track=self.track, lane=self.lane.name, state=state,
            speed_mps=ground, speed_std_mps=std, s_m=float(mean[0]), lateral_m=float(mean[1]),
            position_m=self.front.centre(mean[:3]),
            position_cov_m2=frame @ cov[:3, :3] @ frame.T,
            axes=turned(frame, self._heading_rad()), quad_left_px=left[0],
            quad_right_px=right[0])
        return self._told


def _coasts(update: Optional[TrackUpdate]) -> bool:
    """Say whether the vehicle was not wholly seen in a pair."""
    return update is not None and update.state is TrackState.COASTING


def may_follow(update: TrackUpdate, last: TrackUpdate, config: TrackerConfig) -> bool:
    """Return whether tyres can have changed one speed to the other, as far as both are sure."""
    change = abs(update.speed_mps - last.speed_mps)
    sure = change - config.visibility.speed_change_sigmas * math.hypot(
        update.speed_std_mps, last.speed_std_mps)
    most = config.verdict.most_acceleration_mps2
    return sure <= most * (update.stamp_ns - last.stamp_ns) * 1e-9


def _transport(particles: Array, moments: tuple[Array, Array], target: tuple[Array, Array],
               rng: np.random.Generator) -> Array:
    """
    Carry particles affinely from one mean and covariance to another.

    The map L_to L_from^-1 of the Cholesky factors keeps each particle's relative place, so the
    shape of the cloud survives.  Where resampling has left too few distinct particles to span
    the state there is no shape to keep, and the target is drawn from anew.
    """
    n, dim = particles.shape
    goal = np.linalg.cholesky(0.5 * (target[1] + target[1].T) + _JITTER * np.eye(dim))
    try:
        if len(np.unique(particles[:, 0])) < _DISTINCT_PER_DIM * dim:
            raise np.linalg.LinAlgError('too few distinct particles')
        start = np.linalg.cholesky(moments[1] + _JITTER * np.eye(dim))
    except np.linalg.LinAlgError:
        return target[0] + rng.standard_normal((n, dim)) @ goal.T
    return target[0] + np.linalg.solve(start, (particles - moments[0]).T).T @ goal.T
