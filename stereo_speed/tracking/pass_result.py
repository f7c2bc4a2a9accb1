# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
From a pass's posterior to its result: the speed, its uncertainty budget, and the verdict.

A pass that cannot be measured well is rejected with its reason, never guessed.  The budget is
derived in ``docs/uncertainty.md``.
"""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Optional, Sequence

import numpy as np

from .window import Posterior
from ..core.config import TrackerConfig
from ..core.records import Array, PassResult, SpeedBudget, Verdict
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

_MIN_PAIRS = 4
_MIN_WIDTH_PX = 20.0  # a front that is never wider than this is too far to be measured
_FAR_WIDTH_PX = 40.0  # and one that is never wider than this is uncertain because it is far
_MIN_CROSS_NCC = 0.6  # of half of the looks at least
_MAX_HEIGHT_CHANGE_M = 0.6  # fronts neither climb nor sink against the road
_MAX_SPEED_MPS = 90.0
MAX_ACCELERATION_MPS2 = 12.0  # beyond any tyre


def calibration_share(rig: StereoRig, lane: LanePath, config: TrackerConfig,
                      s_m: Optional[float] = None) -> float:
    """
    1-sigma of the scale of all speeds, as a share: focal length, baseline and the path's length.

    Ranges, and so speeds along the path, are proportional to both (Z = f b / d).

    :param s_m: arc length of a live reading; None for the mean of a pass.
    """
    baseline = config.baseline_std_m / rig.baseline_m
    path = lane.scale_std if s_m is None else float(lane.scale_std_at(np.array(s_m)))
    return math.hypot(config.focal_std, baseline, path)


def live_std(posterior_std_mps: float, speed_mps: float, calibration: float) -> float:
    """1-sigma of a live reading, m/s: images, motion, path and stamps; and calibration."""
    return math.hypot(posterior_std_mps, calibration * speed_mps)


@dataclass(frozen=True, eq=False)
class Pass:
    """
    All that a pass's result follows from.

    :param track: number of the track.
    :param lane: lane whose path it was measured along.
    :param stamps_ns: stamps of the pairs it was wholly seen in; of the first pair if in none.
    :param posterior: of all its looks; None when it was never seen.
    :param exact_speeds: two (n, n) covariances of the speeds: were the stamps exact, and the
        path's heading as well.
    :param width_px: greatest width of its front in a view.
    :param end: how its track ended.
    """

    track: int
    lane: LanePath
    stamps_ns: Sequence[int]
    posterior: Optional[Posterior]
    exact_speeds: Optional[tuple[Array, Array]]
    width_px: float
    end: str


def conclude(found: Pass, rig: StereoRig, config: TrackerConfig) -> PassResult:
    """Measure a pass, or say why it cannot be measured."""
    posterior = found.posterior
    if posterior is None or found.exact_speeds is None:
        return _result(found, pairs=0, reason='never_seen')
    speeds, share = posterior.ground_speeds(), calibration_share(rig, found.lane, config)
    at = (np.array(found.stamps_ns) - posterior.first_ns) * 1e-9
    between = _interpolation(at, posterior.stamps_s)
    profile = between @ speeds
    speed = float(profile.mean())
    budget = _budget(posterior, found.exact_speeds, between.mean(axis=0), abs(speed) * share)
    reason = _reason(found, posterior, speeds, budget.total_mps, (rig, config))
    if reason:
        return _result(found, pairs=len(found.stamps_ns), reason=reason)
    variance = posterior.ground_ratio() ** 2 * np.diag(posterior.covariance)[3::4]
    stds = np.interp(at, posterior.stamps_s, np.sqrt(variance + (share * speeds) ** 2))
    return _result(
        found, pairs=len(found.stamps_ns), reason=reason, speed_mps=speed,
        speed_std_mps=budget.total_mps, budget=budget,
        smoothed=dict(zip(found.stamps_ns, profile.tolist())),
        smoothed_std=dict(zip(found.stamps_ns, stds.tolist())))


def _interpolation(at_s: Array, known_s: Array) -> Array:
    """Shares (m, n) of known times in others, by linear interpolation between neighbours."""
    return np.stack([np.interp(at_s, known_s, row) for row in np.eye(len(known_s))], axis=1)


def _budget(posterior: Posterior, exact_speeds: tuple[Array, Array], mean: Array,
            calibration_mps: float) -> SpeedBudget:
    """
    Split the variance of the mean ground speed by where it comes from.

    :param mean: (n,) shares of the looks' speeds in the mean over all pairs.
    """
    share = posterior.ground_ratio() * mean

    def std(covariance: Array) -> float:
        return math.sqrt(max(float(share @ covariance @ share), 0.0))

    everything = std(posterior.covariance[3::4, 3::4])
    unstamped, matching = (std(covariance) for covariance in exact_speeds)
    return SpeedBudget(
        matching_mps=matching, path_mps=_rest(unstamped, matching),
        stamps_mps=_rest(everything, unstamped), calibration_mps=calibration_mps)


def _rest(whole: float, part: float) -> float:
    return math.sqrt(max(whole ** 2 - part ** 2, 0.0))


def _reason(found: Pass, posterior: Posterior, speeds: Array, std_mps: float,
            instrument: tuple[StereoRig, TrackerConfig]) -> str:
    """Why a pass is rejected, snake_case; empty when it is measured."""
    rig, config = instrument
    if len(found.stamps_ns) < _MIN_PAIRS:
        return 'too_few_pairs'
    if found.width_px < _MIN_WIDTH_PX:
        return 'too_far'
    if not np.median(posterior.cross_ncc) > _MIN_CROSS_NCC:
        return 'views_disagree'
    if np.ptp(posterior.mean[:, 2]) > _MAX_HEIGHT_CHANGE_M:
        return 'off_path'
    gains = np.diff(speeds) / np.diff(posterior.stamps_s)
    if not 0 < speeds.min() <= speeds.max() < _MAX_SPEED_MPS \
            or np.abs(gains).max() > MAX_ACCELERATION_MPS2:
        return 'implausible'
    if not calibration_share(rig, found.lane, config) < config.max_scale_std_share:
        return 'rig_uncertain'
    if not std_mps < max(config.max_speed_std_share * speeds.mean(), config.max_speed_std_mps):
        return 'too_far' if found.width_px < _FAR_WIDTH_PX else 'uncertain'
    return ''


def _result(found: Pass, *, pairs: int, reason: str, speed_mps: Optional[float] = None,
            speed_std_mps: Optional[float] = None, budget: Optional[SpeedBudget] = None,
            smoothed: Optional[dict[int, float]] = None,
            smoothed_std: Optional[dict[int, float]] = None) -> PassResult:
    return PassResult(
        track=found.track, lane=found.lane.name, first_ns=found.stamps_ns[0],
        last_ns=found.stamps_ns[-1], pairs=pairs, speed_mps=speed_mps,
        speed_std_mps=speed_std_mps, verdict=Verdict.REJECTED if reason else Verdict.MEASURED,
        reason=reason, smoothed=smoothed or {}, smoothed_std=smoothed_std or {},
        budget=budget, end=found.end)
