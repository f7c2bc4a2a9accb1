# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What tracks share: particles, and the time to solve for them.

They are solved for one after the other where there is no time for all.
"""
from __future__ import annotations

import math
from typing import Sequence

from .track import holds, Track
from ..core.config import TrackerConfig
from ..tracking.protocol import CanHurry, MOST_TIMES, OCCLUDED_TIMES, OLD_S


def share_of(config: TrackerConfig, tracks: int) -> int:
    """Return the particles of each of so many tracks."""
    wanted = config.particles
    if tracks == 1:
        return wanted
    return min(wanted, max(config.particle_budget // tracks, config.effort.fewest_particles))


def solve_interval_s(config: TrackerConfig, tracks: int) -> float:
    """Return the time between two solutions of each of so many tracks, s."""
    return config.effort.solve_interval_s * (config.particles / share_of(config, tracks))


def take_turns(tracks: Sequence[Track], stamp_ns: int, interval_s: float, *, hurried: bool,
               dense: bool) -> None:
    """
    Tell tracks whether to do little with the next pair.

    Of those that are to be solved for, that has its turn which has waited longest: a pair in
    which all were would take as long as several.  Where pairs are rare, none gives way.

    :param stamp_ns: of the pair.
    :param interval_s: between two solutions of a track.
    :param hurried: whether other pairs wait.
    :param dense: whether pairs come faster than vehicles are solved for.
    """
    waited_s = [track.waited_s(stamp_ns) for track in tracks]
    if hurried:
        waited_s = [one_s if holds(track.last) else one_s / OCCLUDED_TIMES
                    for track, one_s in zip(tracks, waited_s)]
    longest = max(range(len(tracks)), key=waited_s.__getitem__, default=None)
    for k, track in enumerate(tracks):
        gives_way = k != longest and waited_s[k] < math.inf
        track.hurried = gives_way or waited_s[k] < OLD_S if hurried else (
            dense and gives_way and interval_s <= waited_s[k] < MOST_TIMES * interval_s)
        if isinstance(track.tracker, CanHurry):
            track.tracker.hurry(track.hurried)
        if not track.hurried:
            track.unhurried_ns = stamp_ns
