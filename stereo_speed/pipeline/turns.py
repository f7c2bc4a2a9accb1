# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How tracks share the effort: number of particles, and turns to be solved for.

Where there is no time to solve for all tracks in one pair, they take turns.
"""
from __future__ import annotations

import math
from typing import Sequence

from .track import holds, Track
from ..core.tracker_config import TrackerConfig
from ..tracking.protocol import CanHurry, MOST_TIMES, OCCLUDED_TIMES, OLD_S


def share_of(config: TrackerConfig, tracks: int) -> int:
    """Return the number of particles per track for a number of tracks."""
    wanted = config.particles
    if tracks == 1:
        return wanted
    return min(wanted, max(config.particle_budget // tracks, config.effort.fewest_particles))


def solve_interval_s(config: TrackerConfig, tracks: int) -> float:
    """Return the time between two solutions of one track for a number of tracks, s."""
    return config.effort.solve_interval_s * (config.particles / share_of(config, tracks))


def take_turns(tracks: Sequence[Track], stamp_ns: int, interval_s: float, *, hurried: bool,
               dense: bool) -> None:
    """
    Tell tracks whether to do little with the next pair.

    Of the tracks that are due to be solved for, the one that has waited longest has its turn:
    solving for all in one pair would delay that pair.  At low rates no track gives way.

    :param stamp_ns: stamp of the pair.
    :param interval_s: time between two solutions of a track.
    :param hurried: whether other pairs are waiting.
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
