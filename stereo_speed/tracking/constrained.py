# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The path-constrained stereo particle filter of the 2012 paper, made to work at real ranges.

The paper's elements: particles over the place of the front on the road's path and its speed
(eq. 24, 25-27), the likelihood of both views and across them (eq. 12-18), the adaptive reference
(eq. 14), resampling, posterior mean and covariance (eq. 3).  The addition: particles find the
vehicle, but are metres apart at long range.  After each pair the photometric refinement of the
whole pass (``window``) moves them so that their mean and covariance are those of all images so
far.  Depth and offsets thus stay unknowns of the pass instead of being fixed by the first pairs.
"""
from __future__ import annotations

from dataclasses import replace
import math
from typing import Optional, Sequence, Union

import numpy as np

from .cloud import Cloud, transport
from .front import Front, rotated
from .initialise import first_states, place_front, Placement
from .life import TrackLife
from .likelihood import Reference, score
from .motion_prior import PassMotions, PassPrior
from .observation import ObservationSampler
from .pass_result import calibration_share, conclude, live_std, Pass
from .posterior import Posterior
from .protocol import MOST_TIMES, OCCLUDED_TIMES, OLD_S, Refusal, TrackStart
from .window import PhotometricWindow
from ..core.config import NoParameters
from ..core.passes import PassResult, TrackEnd
from ..core.records import Array, StereoPair, TrackState, TrackUpdate
from ..core.stamp_watch import Gap
from ..core.tracker_config import TrackerConfig
from ..estimation.particle_filter import weigh
from ..estimation.resampling import systematic
from ..estimation.weights import DegenerateWeightsError
from ..vision.haar import CELLS, PartGrid


class ConstrainedTracker:
    """
    Follows one vehicle along the path of its lane; see the module's docstring.

    :param start: what the track starts from.
    :param placed: its first front, placed on the path.
    :param grid: samples of the front.
    """

    Settings = NoParameters  # all its parameters are shared by all trackers

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
        self.front: Front = placed.front
        self.life = TrackLife(start)
        of_front = replace(self.config, noise=self.config.noise.of_front(self.front.width_m))
        sampler = ObservationSampler(
            self.rig, self.front, grid.unit_xy, grid.shape, of_front.noise)
        prior = PassPrior(
            s_m=float(placed.pose[0]), s_std_m=placed.s_std_m, offset_m=placed.pose[1:],
            offset_slope=placed.offset_slope, speed_mps=start.expected_mps,
            speed_std_mps=start.expected_std_mps,
            heading_std_rad=np.asarray(self.lane.heading_std_rad))
        self.window = PhotometricWindow(
            sampler, PassMotions.of(prior, of_front, start.nominal_stamp_std_s), of_front)
        s_std_m = self.config.noise.start_std_px / abs(placed.disparity_slope)
        self.cloud = Cloud(first_states(start, placed, s_std_m), np.zeros(self.config.particles),
                           start.pair.stamp_ns)
        self._particles_alone = start.particles_alone or self.config.particles
        self._hurried, self._in_vain = False, 0  # failed attempts to see an occluded vehicle
        self.posterior: Optional[Posterior] = None
        self.reference: Optional[Reference] = None
        self._again_ns: Optional[int] = None  # stamp of the pair that it was reacquired in
        self._astray_ns: Optional[int] = None  # of a pair that does not show it where expected
        self._reported: Optional[TrackUpdate] = None

    @property
    def ended(self) -> bool:
        """Return whether the pass is over: out of view, or lost for too long."""
        return self.life.end is not None

    @property
    def end(self) -> Optional[TrackEnd]:
        """Return how the pass ended; None while it goes on."""
        return self.life.end

    @property
    def particles(self) -> int:
        """Return the number of particles."""
        return len(self.cloud.states)

    @property
    def _own_interval_s(self) -> float:
        """Return the time between solutions, longer where others share the particles."""
        return self.config.effort.solve_interval_s * max(
            1.0, self._particles_alone / self.particles)

    def _solve_interval_s(self, stamp_ns: int) -> float:
        """
        Return the age at which a solution is renewed, s.

        :param stamp_ns: stamp of the next pair.
        """
        interval_s = self._own_interval_s * self._patience(stamp_ns)
        if not self._hurried:
            return interval_s
        times = MOST_TIMES * (OCCLUDED_TIMES if _coasts(self._reported) else 1.0)
        return max(interval_s, times * OLD_S)

    def _patience(self, stamp_ns: int) -> float:
        """
        Return the factor by which to wait longer before looking for an occluded vehicle again.

        It grows with the number of failed looks, until the solution is old, as the vehicle may
        brake.  At low rates the vehicle is looked for in each pair.
        """
        last = self._reported
        if last is None or not _coasts(last) or (
                stamp_ns - last.stamp_ns) * 1e-9 >= self.config.effort.solve_interval_s:
            return 1.0
        return max(1.0, min(1.0 + self._in_vain, OLD_S / self._own_interval_s))

    def share(self, particles: int) -> None:
        """Change the number of particles, when tracks come and go."""
        if particles != self.particles:
            ancestors = systematic(self.cloud.weights, particles, self.rng)
            self.cloud = replace(self.cloud, states=self.cloud.states[ancestors],
                                 log_weights=np.zeros(particles))

    def hurry(self, hurried: bool) -> None:
        """Set whether to do little with the next pairs, because others have their turn."""
        self._hurried = hurried

    def doubt_stamps(self, stamp_std_s: float) -> None:
        """Assume another 1-sigma of all stamps of the pass, s."""
        self.window.doubt_stamps(stamp_std_s)

    def see_gaps(self, gaps: Sequence[Gap]) -> None:
        """Take in the latest gaps of the stream."""
        self.window.gaps = gaps

    @property
    def clock_step(self) -> Optional[Gap]:
        """Return a gap in which the clock was certainly set forward; None if there is none."""
        return self.window.clock.step

    def unsolved_s(self, stamp_ns: int) -> float:
        """Return the age of its last solution, s; infinite where it must solve now."""
        if not (_coasts(self._reported) or self._goes_on(self._reported)):
            return math.inf
        return self.cloud.until_s(stamp_ns) / self._patience(stamp_ns)

    def update(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """Predict, weigh, resample, refine (2012, Section III)."""
        if self.ended:
            return None
        carried = self._carried(pair)
        if carried is not None:
            return carried
        self.cloud = self._predicted(pair.stamp_ns)
        if self._leaves_view(pair):
            return None
        last = self._reported
        measured = self._measured(pair, reacquires=_coasts(last))
        if measured is not None:
            self.cloud, self.posterior = measured
        if measured is None or not measured[1].unoccluded[-1]:
            self._in_vain += 1
            if not self.life.coasts(pair, partly_seen=measured is not None):
                return None
            return self._report(pair, TrackState.COASTING, self.cloud.moments())
        self._in_vain = 0
        self._update_reference(pair)
        state = self.life.seen(pair, self._quads(self.cloud.mean[None], pair)[0][0])
        if _coasts(last):
            self._again_ns = pair.stamp_ns
        update = self._report(
            pair, TrackState.TENTATIVE if self._is_just_back(pair.stamp_ns) else state,
            self.cloud.moments())
        if self.window.clock.doubtful or (
                last is not None and not may_follow(update, last, self.config)):
            update = self._reported = update.unconfirmed()
        return update

    def carry(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """Process a pair by prediction alone; None where it needs a solution."""
        return None if self.ended or _coasts(self._reported) else self._carried(pair)

    def expected(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """
        Return the update predicted for a pair from earlier pairs; None where that is impossible.

        It may run while another thread processes pairs: that thread replaces all data read here
        as a whole, except the blur of one view in the first pairs (``window``), which only affects
        whether the vehicle is found to be visible.
        """
        last, posterior = self._reported, self.posterior
        if self.ended or last is None or posterior is None or pair.stamp_ns == self._astray_ns:
            return None
        if _coasts(last):
            moments = self.cloud.ahead(pair.stamp_ns, self.config, self._lateral_mps())
            return None if self._is_out_of_view(pair, moments[0]) else self._update_of(
                pair, TrackState.COASTING, moments)
        if len(posterior.stamps_s) < 2:
            return None
        after_s = (pair.stamp_ns - posterior.newest_ns) * 1e-9
        moments = posterior.ahead(after_s, self.config)
        if not self.window.shows(pair, moments[0]):
            return None
        update = self._update_of(pair, last.state, moments)
        return update if after_s <= OLD_S else update.unconfirmed()

    def result(self) -> PassResult:
        """Return the measurement of the pass from all its pairs, or why there is none."""
        solved = self.window.solve_pass() if self.life.stamps_ns else None
        stamps_ns = [] if solved is None else [
            ns for ns in self.life.stamps_ns
            if ns >= solved.posterior.first_ns and ns not in solved.occluded_ns]
        followed = Pass(track=self.track, lane=self.lane,
                        stamps_ns=stamps_ns or [self.life.first_ns],
                        solved=solved, extent_px=self.life.extent_px,
                        end=self.life.end or TrackEnd.STREAM_ENDED)
        return conclude(followed, self.rig, self.config)

    def _carried(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """
        Return the update predicted from the last solution; None where a new one is needed.

        Successive readings of a fast camera rest on nearly the same pairs.  So the solution is
        predicted to a pair that agrees with it, and the pair is solved for with the next one.
        """
        posterior, last = self.posterior, self._reported
        after_s = self.cloud.until_s(pair.stamp_ns)
        if last is None or posterior is None or after_s >= self._solve_interval_s(pair.stamp_ns):
            return None
        if _coasts(last):
            moments = self._predicted(pair.stamp_ns).moments()
            # Look for it once more before its pass ends.
            if self.life.is_lost_by(pair.stamp_ns) or self._is_out_of_view(pair, moments[0]):
                return None
            # Checking the expected place is cheap, and nine full searches in ten fail.
            if after_s >= self.config.effort.solve_interval_s \
                    and self.window.shows(pair, moments[0]):
                return None
            return self._report(pair, TrackState.COASTING, moments)
        if not self._goes_on(last) or pair.stamp_ns == self._astray_ns:
            return None
        moments = posterior.ahead(after_s, self.config)
        if not self.window.keep(pair, moments[0]):
            self._astray_ns = pair.stamp_ns  # so that this pair is not checked again
            return None
        state = self.life.seen(pair, self._quads(moments[0][None], pair)[0][0])
        return self._report(pair, state, moments)

    def _is_just_back(self, stamp_ns: int) -> bool:
        """
        Return whether a reacquired vehicle has not shown its speed yet.

        Braking while hidden shows in the second pair; pairs closer in time count as one.
        """
        return self._again_ns is not None and (
            stamp_ns == self._again_ns
            or (stamp_ns - self._again_ns) * 1e-9 < self.config.effort.solve_interval_s)

    def _goes_on(self, last: Optional[TrackUpdate]) -> bool:
        """Return whether the last update can be predicted to a pair, as its speed is known."""
        return last is not None and last.state is TrackState.CONFIRMED \
            and self.posterior is not None and len(self.posterior.stamps_s) >= 2

    # -- the filter's steps ---------------------------------------------------------------

    def _predicted(self, stamp_ns: int) -> Cloud:
        """Return the cloud predicted to the pair of a stamp."""
        return self.cloud.predicted(stamp_ns, self.config, self._lateral_mps(), self.rng)

    def _measured(self, pair: StereoPair, *, reacquires: bool
                  ) -> Optional[tuple[Cloud, Posterior]]:
        """
        Return the particles moved to the posterior of all images so far, and this posterior.

        :param reacquires: whether the front was not wholly seen in the previous pair.
        :return: None when the vehicle is not seen.
        """
        cloud = self._weighed(pair)
        if cloud is None:
            return None
        moments = cloud.moments()
        posterior = self.window.add(pair, moments[0], reacquires=reacquires)
        if posterior is None or not posterior.seen[-1]:
            return None
        states = transport(cloud.states, moments, posterior.at(-1), self.rng)
        return replace(cloud, states=states), posterior

    def _weighed(self, pair: StereoPair) -> Optional[Cloud]:
        """Return the cloud weighed by the images (eq. 2, 12) and resampled, where possible."""
        quads = self._quads(self.cloud.states, pair, pair.right_lag_s)
        scores = score(pair.left, pair.right, quads, self.reference, grid=self.grid,
                       config=self.config)
        try:
            weighed = weigh(self.cloud.log_weights, scores.log_likelihood,
                            self.config.resample_ess, self.rng)
        except DegenerateWeightsError:
            return None
        return replace(self.cloud, states=self.cloud.states[weighed.ancestors],
                       log_weights=weighed.log_weights)

    def _update_reference(self, pair: StereoPair) -> None:
        """Blend the features at the estimated state into the reference (eq. 14)."""
        quads = self._quads(self.cloud.mean[None], pair, pair.right_lag_s)
        at = score(pair.left, pair.right, quads, None, grid=self.grid, config=self.config)
        if self.reference is None:
            self.reference = Reference(at.left[0], at.right[0])
        else:
            self.reference = self.reference.updated(
                at.left[0], at.right[0], self.config.reference_epsilon)

    # -- what is reported -----------------------------------------------------------------

    def _lateral_mps(self) -> float:
        """Return the rate at which the vehicle crosses its path, from all observations so far."""
        return 0.0 if self.posterior is None else float(self.posterior.lateral_mps[-1])

    def _heading_rad(self) -> float:
        """Return the heading of the vehicle against its path, which follows from its motion."""
        return 0.0 if self.posterior is None else float(self.posterior.heading_rad[-1])

    def _quads(self, states: Array, pair: StereoPair, lag_s: float = 0.0
               ) -> tuple[Array, Array]:
        """Return the corners (N, 4, 2) of the front at states (N, 4), both views of a pair."""
        later = None
        if lag_s:
            rate = np.full(len(states), self._lateral_mps())
            later = states[:, :3] + lag_s * np.column_stack([states[:, 3], rate, 0 * rate])
        return self.front.corners(self.rig.as_taken(pair.motion), states[:, :3],
                                  self._heading_rad(), later)

    def _leaves_view(self, pair: StereoPair) -> bool:
        """Return whether the pass ends before this pair, out of view or far beyond the path."""
        if self._is_out_of_view(pair, self.cloud.mean):
            self.life.end = TrackEnd.LEFT_VIEW
        return self.life.end is not None

    def _is_out_of_view(self, pair: StereoPair, mean: Array) -> bool:
        """Return whether a front at s, a, b, v (4,) is out of view or far beyond the path."""
        left, right = self._quads(mean[None], pair)
        beyond_m = float(mean[0]) - self.lane.path.length_m
        return beyond_m > self.config.visibility.beyond_path_m or self.life.is_too_far(left[0]) \
            or not self.life.is_in_view(left[0], right[0])

    def _report(self, pair: StereoPair, state: TrackState, moments: tuple[Array, Array]
                ) -> TrackUpdate:
        """Return the update of the newest pair and keep it; arguments as for ``_update_of``."""
        self._reported = self._update_of(pair, state, moments)
        return self._reported

    def _update_of(self, pair: StereoPair, state: TrackState, moments: tuple[Array, Array]
                   ) -> TrackUpdate:
        """
        Return the update of a pair.

        :param moments: mean (4,) and covariance (4, 4) of s, a, b, v.
        """
        mean, cov = moments
        frame = self.lane.path.frame(np.array(mean[0]))
        left, right = self._quads(mean[None], pair)
        ground = self.front.ground_speed(mean[:3], float(mean[3]), self._lateral_mps())
        scale = self.front.path_scale(mean[None, :3])[0]  # see Posterior.ground_stds
        share = calibration_share(self.rig, self.lane, self.config, float(mean[0]))
        std = live_std(float(scale * np.sqrt(cov[3, 3])), ground, share)
        return TrackUpdate(
            stamp_ns=pair.stamp_ns, track=self.track, lane=self.lane.name, state=state,
            speed_mps=ground, speed_std_mps=std, s_m=float(mean[0]), lateral_m=float(mean[1]),
            position_m=self.front.centre(mean[:3]),
            position_cov_m2=frame @ cov[:3, :3] @ frame.T,
            axes=rotated(frame, self._heading_rad()), quad_left_px=left[0],
            quad_right_px=right[0], unnoticed_mps=self._unnoticed_mps(pair.stamp_ns))

    def _unnoticed_mps(self, stamp_ns: int) -> float:
        """Return the error of the speed at a stamp from braking that does not show yet, m/s."""
        return 0.0 if self.posterior is None else self.posterior.unnoticed_mps(stamp_ns)


def _coasts(update: Optional[TrackUpdate]) -> bool:
    """Return whether an update is of a pair that did not show the whole front."""
    return update is not None and update.state is TrackState.COASTING


def may_follow(update: TrackUpdate, last: TrackUpdate, config: TrackerConfig) -> bool:
    """Return whether an acceleration within limits explains two speeds, given their 1-sigmas."""
    change = abs(update.speed_mps - last.speed_mps)
    sure = change - config.visibility.speed_change_sigmas * math.hypot(
        update.speed_std_mps, last.speed_std_mps)
    most = config.verdict.most_acceleration_mps2
    return sure <= most * (update.stamp_ns - last.stamp_ns) * 1e-9
