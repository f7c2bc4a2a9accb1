# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The second estimate of a pass, and its comparison with the first one.

Both estimates share the rig, the stamps and the direction of the lane's path. Errors of these
affect both alike, and the comparison cannot reveal them.
"""
from __future__ import annotations

from dataclasses import replace
import math
from typing import Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .points import CornerFollower
from .rigid import Places, places_of, Rays
from .speed import speeds_at
from ..core.passes import PassResult, Reason, SecondEstimate, time_shares
from ..core.records import Array, StereoPair
from ..core.tracker_config import SecondConfig, TrackerConfig
from ..core.units import seconds
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

_SLOPE_M = 0.05  # step for finite differences along a path


class SecondOpinion:
    """
    Follows corners on one vehicle through its pairs and estimates its speed from them.

    :param rig: the rig.
    :param lane: lane whose path the vehicle follows.
    :param config: parameters; the section ``second`` and the tolerances are used.
    """

    def __init__(self, rig: StereoRig, lane: LanePath, config: TrackerConfig) -> None:
        self.rig, self.lane, self.config = rig, lane, config
        self._corners = CornerFollower(config.second)
        self._rays: list[Rays] = []
        self._first_ns: Optional[int] = None
        self._taken_ns: Optional[int] = None

    def take(self, pair: StereoPair, left_region: Array, right_region: Array) -> None:
        """
        Process the next pair, unless it follows the last one too soon to add information.

        :param left_region: (4, 2) outline of the vehicle in the raw left view, px.
        :param right_region: (4, 2) outline of the vehicle in the raw right view, px.
        """
        if self._taken_ns is not None and \
                seconds(pair.stamp_ns, self._taken_ns) < self.config.second.interval_s:
            return
        self._taken_ns = pair.stamp_ns
        seen = self._corners.take(pair, left_region, right_region)
        if seen is None:
            return
        if self._first_ns is None:
            self._first_ns = pair.stamp_ns
        rig = self.rig.as_taken(pair.motion)
        self._rays.append(Rays(
            rig, seconds(pair.stamp_ns, self._first_ns), pair.right_lag_s, seen.ids,
            rig.left.rays(seen.left_px)[:, :2], rig.right.rays(seen.right_px)[:, :2],
            seen.crowding).finite())

    def estimate(self, stamps_ns: Sequence[int] = ()) -> SecondEstimate:
        """
        Return the estimate of the mean ground speed over time.

        :param stamps_ns: stamps of the pairs of the pass, ns; if empty, those of the pairs that
            the estimate is based on.
        """
        config = self.config.second
        sightings = self._sightings()
        if len(sightings) < config.least_pairs:
            return SecondEstimate(None, None, len(sightings))
        places = places_of(sightings, self.lane.path, config)
        wanted = places.stamps_s if not stamps_ns else np.array(
            [seconds(ns, self._first_ns or 0) for ns in stamps_ns])
        shares = time_shares([round(at * 1e9) for at in wanted])
        speed, std = self._mean_speed(places, wanted, shares)
        if not (speed > 0 and std <= config.most_std_share * speed):
            return SecondEstimate(None, None, len(sightings))
        return SecondEstimate(speed, std, len(sightings))

    def _sightings(self) -> list[Rays]:
        """Return evenly spaced pairs, with the corners that are seen in more than one of them."""
        config, taken = self.config.second, self._rays
        if len(taken) > config.most_pairs:
            chosen = np.unique(np.linspace(0, len(taken) - 1, config.most_pairs).round())
            taken = [taken[int(k)] for k in chosen]
        while taken:
            common = _repeated_ids([rays.ids for rays in taken])
            kept = [rays.only(np.isin(rays.ids, common)) for rays in taken]
            good = [rays for rays in kept if len(rays.ids) >= config.least_points]
            if len(good) == len(taken):
                return good
            taken = good
        return []

    def _mean_speed(self, places: Places, wanted_s: Array, shares: Array) -> tuple[float, float]:
        """
        Return the weighted mean of the ground speed and its 1-sigma, m/s.

        :param wanted_s: (n,) times at which the speed enters the mean, s.
        :param shares: (n,) weights of these times.
        """
        along, across = places.place[:, 0], places.place[:, 1]
        rough = float(np.polyfit(places.stamps_s, along, 1)[0])
        stamps = np.eye(len(along)) * (self.config.stamp_std_s * rough) ** 2
        v_along, covariance = speeds_at(
            places.stamps_s, along, places.covariance[:, 0, :, 0] + stamps, wanted_s)
        v_across, _ = speeds_at(places.stamps_s, across, places.covariance[:, 1, :, 1], wanted_s)
        stretch = _stretch(self.lane, *(np.interp(wanted_s, places.stamps_s, values)
                                        for values in (along, across)))
        ground = np.hypot(v_along * stretch, v_across)
        mean, share = float(shares @ ground), shares * stretch
        return mean, math.hypot(math.sqrt(float(share @ covariance @ share)),
                                self._calibration() * mean)

    def _calibration(self) -> float:
        """Return the relative 1-sigma of all speeds by the rig, as Z = f b / d."""
        return math.hypot(self.config.focal_std, self.config.baseline_std_m / self.rig.baseline_m,
                          self.lane.scale_std)


def _repeated_ids(ids: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return the ids that are in more than one list."""
    if not ids:
        return np.zeros(0, np.int64)
    found, counts = np.unique(np.concatenate(ids), return_counts=True)
    return np.asarray(found[counts > 1])


def _stretch(lane: LanePath, s_m: Array, left_m: Array) -> Array:
    """Return the ratios (n,) of lengths at an offset to the left of a path to lengths along it."""
    ends = [lane.path.position(s) + left_m[:, None] * lane.path.frame(s)[..., 1]
            for s in (s_m - _SLOPE_M, s_m + _SLOPE_M)]
    return np.asarray(np.linalg.norm(ends[1] - ends[0], axis=1) / (2 * _SLOPE_M))


def compared(result: PassResult, config: SecondConfig) -> PassResult:
    """
    Return a pass that has a second estimate, rejected if the two estimates disagree.

    Without a second estimate the pass is returned as it is.  A second estimate so uncertain that
    its own error may explain the difference is discarded.
    """
    second = result.second
    if result.speed_mps is None or second is None or second.speed_mps is None:
        return result
    off_mps = abs(result.speed_mps - second.speed_mps)
    std_mps = math.hypot(result.speed_std_mps or 0.0, second.speed_std_mps or 0.0)
    if off_mps <= min(config.most_sigmas * std_mps, config.most_difference_mps):
        return result
    if off_mps < min(config.least_sigmas, config.most_sigmas) * std_mps:
        return replace(result, second=SecondEstimate(None, None, second.pairs))
    return result.rejected(Reason.SECOND_ESTIMATE)


def with_second(result: PassResult, opinion: SecondOpinion, config: SecondConfig) -> PassResult:
    """Return a pass with its second estimate added, rejected if the two disagree."""
    return compared(replace(result, second=opinion.estimate(sorted(result.smoothed))), config)
