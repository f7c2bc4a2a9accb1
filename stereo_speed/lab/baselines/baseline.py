# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The common part of all baselines: the steps of a track, its reports, and the verdict on its pass.

A baseline estimates position and velocity of the front in 3-D; the path of its lane serves only to
report the position along the lane and beside it.
"""
from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
import math
from typing import ClassVar, Generic, Optional, TypeVar, Union

import numpy as np

from .constant_velocity import Gaussian, Transition
from .settings import MotionSettings
from .speed_profile import Profile, smoothed_profile
from ...core.passes import PassResult, Reason, time_shares, TrackEnd, Verdict
from ...core.records import Array, StereoPair, TrackState, TrackUpdate
from ...tracking.initialise import place_front, Placement
from ...tracking.life import TrackLife
from ...tracking.pass_result import calibration_share, live_std
from ...tracking.protocol import Refusal, TrackStart
from ...vision.haar import PartGrid

OwnSettings = TypeVar('OwnSettings', bound=MotionSettings)


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    The estimate of a baseline after a pair.

    :param position_m: (3,), centre of the front, left optical frame.
    :param position_cov: (3, 3), its covariance, m^2.
    :param velocity_mps: (3,), velocity of the centre.
    :param velocity_cov: (3, 3), its covariance, m^2/s^2.
    :param axes: (3, 3), with the columns heading, left and up.
    :param quads: (4, 2), corners in the left and in the right raw view, px.
    """

    position_m: Array
    position_cov: Array
    velocity_mps: Array
    velocity_cov: Array
    axes: Array
    quads: tuple[Array, Array]

    @property
    def speed_mps(self) -> float:
        """Return the magnitude of the velocity."""
        return float(np.linalg.norm(self.velocity_mps))

    @property
    def speed_std_mps(self) -> float:
        """Return the 1-sigma of the speed."""
        along = self.velocity_mps / max(self.speed_mps, 1e-9)
        return math.sqrt(max(float(along @ self.velocity_cov @ along), 0.0))


class Baseline(ABC, Generic[OwnSettings]):
    """
    Track one vehicle; each baseline implements the use of the images.

    :param start: start of the track.
    :param placed: placement of its first front.
    :param settings: parameters of this baseline.
    """

    Settings: ClassVar[type[MotionSettings]]
    unseen_reason = Reason.NEVER_SEEN  # reason for rejecting a pass without an observation

    @classmethod
    def start(cls, start: TrackStart, settings: OwnSettings
              ) -> Union[Baseline[OwnSettings], Refusal]:
        """Return a baseline that tracks a front, or the reason why it cannot."""
        grid = PartGrid(start.config.parts, start.config.samples_per_part)
        placed = place_front(start, grid)
        return placed if isinstance(placed, Refusal) else cls(start, placed, settings)

    def __init__(self, start: TrackStart, placed: Placement, settings: OwnSettings) -> None:
        self.rig, self.lane, self.config = start.rig, start.lane, start.config
        self.track, self.rng, self.settings = start.track, start.rng, settings
        self.placed, self.life = placed, TrackLife(start)
        self.missed = 0  # number of pairs in which it was not seen
        # For each pair: belief, the transition to it, and whether the vehicle was seen.
        self.filtered: list[Gaussian] = []
        self.steps: list[Transition] = []
        self.seen: list[bool] = []
        self.calibration = calibration_share(self.rig, self.lane, self.config)

    # -- implemented by each baseline -------------------------------------------------------

    @abstractmethod
    def _predict(self, dt_s: float) -> None:
        """Predict the state at the time of the next pair."""

    @abstractmethod
    def _observe(self, pair: StereoPair) -> bool:
        """Update by a pair; return False and keep the prediction when the vehicle is not seen."""

    @abstractmethod
    def _estimate(self) -> Estimate:
        """Return the state."""

    def _profile(self) -> Profile:
        """Return the speeds in the pairs (two or more) with observations, from all of them."""
        return smoothed_profile(self.filtered, self.steps, self.seen)

    # -- the protocol -----------------------------------------------------------------------

    @property
    def ended(self) -> bool:
        """Return whether the pass has ended: out of view, or lost for too long."""
        return self.life.end is not None

    @property
    def end(self) -> Optional[TrackEnd]:
        """Return how the pass ended; None while it goes on."""
        return self.life.end

    def update(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """Process one pair, in order of stamps; return None once the pass has ended."""
        if self.ended:
            return None
        self._predict(self.life.advance_s(pair))
        if self.life.leaves_view(*self._estimate().quads):
            return None
        if self._observe(pair):
            estimate = self._estimate()
            return self._report(pair, self.life.seen(pair, estimate.quads[0]), estimate)
        self.missed += 1
        if not self.life.coasts(pair):
            return None
        return self._report(pair, TrackState.COASTING, self._estimate())

    def doubt_stamps(self, stamp_std_s: float) -> None:
        """Do nothing: the 1-sigma of a baseline comes from the scatter of its positions."""

    def result(self) -> PassResult:
        """Return the measurement of the pass from all its pairs, with its verdict."""
        seen = len(self.life.stamps_ns)
        if seen < 2:
            return self._result(Reason.TOO_FEW_PAIRS if seen else self.unseen_reason, None)
        profile = self._profile()
        return self._result(self._reason(profile), profile)

    # -- the parts --------------------------------------------------------------------------

    def _report(self, pair: StereoPair, state: TrackState, estimate: Estimate) -> TrackUpdate:
        path, speed = self.lane.path, estimate.speed_mps
        s_m = path.arc_length(estimate.position_m)
        offset = (estimate.position_m - path.position(s_m)) @ path.frame(s_m)
        return TrackUpdate(
            stamp_ns=pair.stamp_ns, track=self.track, lane=self.lane.name, state=state,
            speed_mps=speed,
            speed_std_mps=live_std(estimate.speed_std_mps, speed, self.calibration),
            s_m=float(s_m), lateral_m=float(offset[1]), position_m=estimate.position_m,
            position_cov_m2=estimate.position_cov, axes=estimate.axes,
            quad_left_px=estimate.quads[0], quad_right_px=estimate.quads[1])

    def _reason(self, profile: Profile) -> Optional[Reason]:
        """Return the reason why a pass is rejected; None when it is measured."""
        limits, seen = self.config.verdict, len(self.life.stamps_ns)
        if seen < limits.least_pairs:
            return self.unseen_reason if self.missed > seen else Reason.TOO_FEW_PAIRS
        if self.life.extent_px < limits.least_width_px:
            return Reason.TOO_FAR
        speed, mean = profile.speed_mps, float(profile.speed_mps.mean())
        if not (np.isfinite(speed).all() and 0 < speed.min()
                and speed.max() < limits.most_speed_mps):
            return Reason.IMPLAUSIBLE
        std = math.hypot(profile.mean_std_mps, self.calibration * mean)
        if not std < max(self.config.max_speed_std_share * mean, self.config.max_speed_std_mps):
            far = self.life.extent_px < limits.far_width_px
            return Reason.TOO_FAR if far else Reason.UNCERTAIN
        return None

    def _result(self, reason: Optional[Reason], profile: Optional[Profile]) -> PassResult:
        stamps = self.life.stamps_ns or [self.life.first_ns]
        speed = std = None
        smoothed: dict[int, float] = {}
        smoothed_std: dict[int, float] = {}
        if profile is not None:
            speed = float(time_shares(stamps) @ profile.speed_mps)
            std = math.hypot(profile.mean_std_mps, self.calibration * speed)
            stds = np.hypot(profile.std_mps, self.calibration * profile.speed_mps)
            smoothed = dict(zip(stamps, profile.speed_mps.tolist()))
            smoothed_std = dict(zip(stamps, stds.tolist()))
        # A rejected pass keeps its figures, because baselines serve for comparison.
        return PassResult(
            track=self.track, lane=self.lane.name, first_ns=stamps[0], last_ns=stamps[-1],
            pairs=len(self.life.stamps_ns), speed_mps=speed, speed_std_mps=std,
            verdict=Verdict.REJECTED if reason else Verdict.MEASURED, reason=reason or '',
            smoothed=smoothed, smoothed_std=smoothed_std,
            end=self.life.end or TrackEnd.STREAM_ENDED)
