# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What all baselines share: the life of a track, what is told of it, and the verdict on its pass.

A baseline knows the place and the velocity of the front in 3-D; only to tell where along the
lane and how far beside it that is, is the lane's path used.
"""
from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
import math
from typing import Optional, Union

import numpy as np

from .settings import BaselineSettings
from .speed_profile import Profile
from ...core.records import (
    Array, PassResult, Reason, StereoPair, TrackEnd, TrackState, TrackUpdate, Verdict)
from ...tracking.initialise import place_front, Placement
from ...tracking.pass_result import calibration_share, live_std
from ...tracking.protocol import Refusal, TrackStart
from ...vision.haar import PartGrid


@dataclass(frozen=True, eq=False)
class Reading:
    """
    What a baseline knows after a pair.

    :param position_m: (3,) centre of the front, left optical frame.
    :param position_cov: (3, 3) m^2.
    :param velocity_mps: (3,) of the centre.
    :param velocity_cov: (3, 3) m^2/s^2.
    :param axes: (3, 3) columns are heading, left and up.
    :param quads: (4, 2) corners in the left and in the right raw view, px.
    """

    position_m: Array
    position_cov: Array
    velocity_mps: Array
    velocity_cov: Array
    axes: Array
    quads: tuple[Array, Array]

    @property
    def speed_mps(self) -> float:
        """Length of the velocity."""
        return float(np.linalg.norm(self.velocity_mps))

    @property
    def speed_std_mps(self) -> float:
        """1-sigma of the speed."""
        along = self.velocity_mps / max(self.speed_mps, 1e-9)
        return math.sqrt(max(float(along @ self.velocity_cov @ along), 0.0))


class Baseline(ABC):
    """
    Follow one vehicle; what is done with the images is left to each baseline.

    :param start: what the track starts from; the path of its lane places the first front, and
        tells s and the offset.
    :param placed: where its first front stands.
    :param settings: parameters of the baselines alone.
    """

    Settings = BaselineSettings
    unseen_reason = Reason.NEVER_SEEN  # why a pass without an observation is rejected

    @classmethod
    def start(cls, start: TrackStart, settings: BaselineSettings) -> Union[Baseline, Refusal]:
        """Return a baseline that follows a front, or the reason why it cannot."""
        grid = PartGrid(start.config.parts, start.config.samples_per_part)
        placed = place_front(start, grid)
        return placed if isinstance(placed, Refusal) else cls(start, placed, settings)

    def __init__(self, start: TrackStart, placed: Placement, settings: BaselineSettings) -> None:
        self.rig, self.lane, self.config = start.rig, start.lane, start.config
        self.track, self.rng, self.settings = start.track, start.rng, settings
        self.grid = PartGrid(self.config.parts, self.config.samples_per_part)
        self.expected_mps, self.placed = start.expected_mps, placed
        self.first_ns = self.last_ns = self.seen_ns = start.pair.stamp_ns
        self.stamps_ns: list[int] = []  # of the pairs it was seen in
        self.missed = 0
        self.width_px = 0.0
        self.calibration = calibration_share(self.rig, self.lane, self.config)
        self._end: Optional[TrackEnd] = None

    # -- what each baseline does ------------------------------------------------------------

    @abstractmethod
    def _predict(self, dt_s: float) -> None:
        """Carry the state to the time of the next pair."""

    @abstractmethod
    def _observe(self, pair: StereoPair, lag_s: float) -> bool:
        """Take in a pair; False, and the state as predicted, when the vehicle is not seen."""

    @abstractmethod
    def _reading(self) -> Reading:
        """Tell the state."""

    @abstractmethod
    def _profile(self) -> Profile:
        """Measure the speeds in the pairs it was seen in, from all of them; at least two."""

    # -- the protocol -----------------------------------------------------------------------

    @property
    def ended(self) -> bool:
        """Whether the pass is over: out of view, or lost for too long."""
        return self._end is not None

    def update(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """Take in one pair, in order of stamps; None once the pass has ended."""
        if self._end:
            return None
        self._predict((pair.stamp_ns - self.last_ns) * 1e-9)
        self.last_ns = pair.stamp_ns
        quads = self._reading().quads
        if not (self.rig.left.holds(quads[0]) and self.rig.right.holds(quads[1])):
            self._end = TrackEnd.LEFT_VIEW
            return None
        if not self._observe(pair, pair.right_lag_s(self.config.trigger_tolerance_s)):
            self.missed += 1
            if (pair.stamp_ns - self.seen_ns) * 1e-9 > self.config.visibility.lost_after_s:
                self._end = TrackEnd.LOST
                return None
            return self._tell(pair, TrackState.COASTING)
        self.seen_ns = pair.stamp_ns
        self.stamps_ns.append(pair.stamp_ns)
        confirmed = len(self.stamps_ns) >= self.config.visibility.confirm_pairs
        return self._tell(pair, TrackState.CONFIRMED if confirmed else TrackState.TENTATIVE)

    def result(self) -> PassResult:
        """Measure the pass from all its pairs, or say why it cannot be measured."""
        if len(self.stamps_ns) < 2:
            reason = Reason.TOO_FEW_PAIRS if self.stamps_ns else self.unseen_reason
            return self._result(reason, None)
        profile = self._profile()
        return self._result(self._reason(profile), profile)

    # -- the parts --------------------------------------------------------------------------

    def _first_velocity(self) -> tuple[Array, float]:
        """Velocity to begin with, that of the speed limit along the lane, and its 1-sigma."""
        tangent = self.lane.path.tangent(np.array(self.placed.pose[0]))
        return (self.expected_mps * tangent,
                2 * self.config.initial_speed_std * self.expected_mps)

    def _tell(self, pair: StereoPair, state: TrackState) -> TrackUpdate:
        reading = self._reading()
        if state is not TrackState.COASTING:
            self.width_px = max(self.width_px, float(np.ptp(reading.quads[0][:, 0])))
        path, speed = self.lane.path, reading.speed_mps
        s_m = path.arc_length(reading.position_m)
        offset = (reading.position_m - path.position(s_m)) @ path.frame(s_m)
        return TrackUpdate(
            stamp_ns=pair.stamp_ns, track=self.track, lane=self.lane.name, state=state,
            speed_mps=speed,
            speed_std_mps=live_std(reading.speed_std_mps, speed, self.calibration),
            s_m=float(s_m), lateral_m=float(offset[1]), position_m=reading.position_m,
            position_cov_m2=reading.position_cov, axes=reading.axes,
            quad_left_px=reading.quads[0], quad_right_px=reading.quads[1])

    def _reason(self, profile: Profile) -> Optional[Reason]:
        """Return why a pass is rejected; None when it is measured."""
        limits = self.config.verdict
        if len(self.stamps_ns) < limits.least_pairs:
            return self.unseen_reason if self.missed > len(self.stamps_ns) else Reason.TOO_FEW_PAIRS
        if self.width_px < limits.least_width_px:
            return Reason.TOO_FAR
        speed, mean = profile.speed_mps, float(profile.speed_mps.mean())
        if not (np.isfinite(speed).all() and 0 < speed.min() and speed.max() < limits.most_speed_mps):
            return Reason.IMPLAUSIBLE
        std = math.hypot(profile.mean_std_mps, self.calibration * mean)
        if not std < max(self.config.max_speed_std_share * mean, self.config.max_speed_std_mps):
            return Reason.TOO_FAR if self.width_px < limits.far_width_px else Reason.UNCERTAIN
        return None

    def _result(self, reason: Optional[Reason], profile: Optional[Profile]) -> PassResult:
        stamps = self.stamps_ns or [self.first_ns]
        speed = std = None
        smoothed: dict[int, float] = {}
        smoothed_std: dict[int, float] = {}
        if profile is not None:
            speed = float(profile.speed_mps.mean())
            std = math.hypot(profile.mean_std_mps, self.calibration * speed)
            stds = np.hypot(profile.std_mps, self.calibration * profile.speed_mps)
            smoothed = dict(zip(stamps, profile.speed_mps.tolist()))
            smoothed_std = dict(zip(stamps, stds.tolist()))
        # A rejected pass keeps its figures: baselines are there to be compared, not to fine.
        return PassResult(
            track=self.track, lane=self.lane.name, first_ns=stamps[0], last_ns=stamps[-1],
            pairs=len(self.stamps_ns), speed_mps=speed, speed_std_mps=std,
            verdict=Verdict.REJECTED if reason else Verdict.MEASURED, reason=reason or '',
            smoothed=smoothed, smoothed_std=smoothed_std, end=self._end or TrackEnd.STREAM_ENDED)
