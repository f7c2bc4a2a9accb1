# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The result of a pass from its posterior: the speed, its uncertainty budget, and the verdict.

A pass that cannot be measured well is rejected with its reason.  The budget is derived in
``docs/uncertainty.md``.
"""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Optional, Sequence

import numpy as np

from .posterior import SolvedPass
from ..core.passes import PassResult, Reason, SpeedBudget, time_shares, TrackEnd, Verdict
from ..core.records import Array
from ..core.tracker_config import TrackerConfig
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath


def rig_share(rig: StereoRig, lane: LanePath, config: TrackerConfig,
              s_m: Optional[float] = None) -> float:
    """
    Return the 1-sigma of the scale of all speeds due to the rig, as a share.

    Focal length, baseline and the length of the path contribute to it: ranges, and so speeds along
    the path, are proportional to the first two (Z = f b / d).

    :param s_m: arc length of a live reading, m; None for the mean of a pass.
    """
    baseline = config.baseline_std_m / rig.baseline_m
    path = lane.scale_std if s_m is None else float(lane.scale_std_at(np.array(s_m)))
    return math.hypot(config.focal_std, baseline, path)


def calibration_share(rig: StereoRig, lane: LanePath, config: TrackerConfig,
                      s_m: Optional[float] = None) -> float:
    """
    Return the 1-sigma of the scale of all speeds due to the rig and to the shape of the path.

    :param s_m: as for :func:`rig_share`.
    """
    return math.hypot(rig_share(rig, lane, config, s_m), lane.shape_std)


def live_std(posterior_std_mps: float, speed_mps: float, calibration: float) -> float:
    """Return the 1-sigma of a live reading, m/s, from its posterior and the calibration."""
    return math.hypot(posterior_std_mps, calibration * speed_mps)


@dataclass(frozen=True, eq=False)
class Pass:
    """
    The data from which the result of a pass follows.

    :param track: number of the track.
    :param lane: lane whose path it was measured along.
    :param stamps_ns: stamps of the pairs that show the whole front; of the first pair if none do.
    :param solved: solution from all its observations; None when it was never seen.
    :param extent_px: greatest width or height of its front in the left view, px.
    :param end: how its track ended.
    """

    track: int
    lane: LanePath
    stamps_ns: Sequence[int]
    solved: Optional[SolvedPass]
    extent_px: float
    end: TrackEnd


def conclude(followed: Pass, rig: StereoRig, config: TrackerConfig) -> PassResult:
    """Return the measurement of a pass, or why it cannot be measured."""
    if followed.solved is None:
        return _result(followed, pairs=0, reason=Reason.NEVER_SEEN)
    posterior = followed.solved.posterior
    speeds, share = posterior.ground_speeds(), calibration_share(rig, followed.lane, config)
    at = (np.array(followed.stamps_ns) - posterior.first_ns) * 1e-9
    between = _interpolation(at, posterior.stamps_s)
    profile, of_time = between @ speeds, time_shares(followed.stamps_ns)
    speed = float(of_time @ profile)
    budget = _budget(followed.solved, of_time @ between, abs(speed) * share)
    reason = _reason(followed, followed.solved, speeds, (speed, budget.total_mps),
                     rig_share(rig, followed.lane, config), config)
    if reason:
        return _result(followed, pairs=len(followed.stamps_ns), reason=reason)
    stds = np.interp(at, posterior.stamps_s, np.hypot(posterior.ground_stds(), share * speeds))
    return _result(
        followed, pairs=len(followed.stamps_ns), speed_mps=speed,
        speed_std_mps=budget.total_mps, budget=budget,
        smoothed=dict(zip(followed.stamps_ns, profile.tolist())),
        smoothed_std=dict(zip(followed.stamps_ns, stds.tolist())))


def _interpolation(at_s: Array, known_s: Array) -> Array:
    """Return the weights (m, n) of known times in linear interpolation at other times."""
    return np.stack([np.interp(at_s, known_s, row) for row in np.eye(len(known_s))], axis=1)


def _budget(solved: SolvedPass, mean: Array, calibration_mps: float) -> SpeedBudget:
    """
    Return the uncertainty of the mean ground speed, split by its sources.

    :param mean: (n,) weights of the observations' speeds in the mean over the pass.
    """
    share = solved.posterior.path_scale * mean

    def std(covariance: Array) -> float:
        return math.sqrt(max(float(share @ covariance @ share), 0.0))

    everything = std(solved.posterior.covariance[3::4, 3::4])
    unstamped, matching = std(solved.exact_stamps), std(solved.exact_path)
    return SpeedBudget(
        matching_mps=matching, path_mps=_rest(unstamped, matching),
        stamps_mps=_rest(everything, unstamped), calibration_mps=calibration_mps)


def _rest(whole: float, part: float) -> float:
    return math.sqrt(max(whole ** 2 - part ** 2, 0.0))


def _reason(followed: Pass, solved: SolvedPass, speeds: Array, mean: tuple[float, float],
            share: float, config: TrackerConfig) -> Optional[Reason]:
    """
    Return why a pass is rejected; None if it is not.

    :param solved: its solution.
    :param speeds: (n,) ground speed in each observation, m/s.
    :param mean: the speed of the pass and its 1-sigma, m/s.
    :param share: 1-sigma of the scale due to the rig.
    """
    limits, posterior, (speed_mps, std_mps) = config.verdict, solved.posterior, mean
    if len(followed.stamps_ns) < limits.least_pairs:
        return Reason.TOO_FEW_PAIRS
    if followed.extent_px < limits.least_width_px:
        return Reason.TOO_FAR
    if not np.median(posterior.cross_ncc) > limits.least_median_ncc:
        return Reason.VIEWS_DISAGREE
    if solved.clock_set:
        return Reason.STAMPS_UNCERTAIN
    if np.ptp(posterior.mean[:, 2]) > limits.most_height_change_m:
        return Reason.OFF_PATH
    gains = np.diff(speeds) / np.diff(posterior.stamps_s)
    if not 0 < speeds.min() <= speeds.max() < limits.most_speed_mps \
            or np.abs(gains).max() > limits.most_acceleration_mps2 \
            or speed_mps < config.association.moving_sigmas * std_mps:
        return Reason.IMPLAUSIBLE
    if not share < config.max_scale_std_share:
        return Reason.RIG_UNCERTAIN
    if not std_mps < max(config.max_speed_std_share * speeds.mean(), config.max_speed_std_mps):
        far = followed.extent_px < limits.far_width_px
        return Reason.TOO_FAR if far else Reason.UNCERTAIN
    if solved.scatter_px > limits.most_scatter_px:  # last, as any of the above may be the cause
        return Reason.VIEWS_DISAGREE
    return None


def _result(followed: Pass, *, pairs: int, reason: Optional[Reason] = None,
            speed_mps: Optional[float] = None, speed_std_mps: Optional[float] = None,
            budget: Optional[SpeedBudget] = None,
            smoothed: Optional[dict[int, float]] = None,
            smoothed_std: Optional[dict[int, float]] = None) -> PassResult:
    return PassResult(
        track=followed.track, lane=followed.lane.name, first_ns=followed.stamps_ns[0],
        last_ns=followed.stamps_ns[-1], pairs=pairs, speed_mps=speed_mps,
        speed_std_mps=speed_std_mps, verdict=Verdict.REJECTED if reason else Verdict.MEASURED,
        reason=reason or '', smoothed=smoothed or {}, smoothed_std=smoothed_std or {},
        budget=budget, end=followed.end)
