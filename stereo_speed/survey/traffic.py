# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Traffic statistics over many passes: mean, 85th percentile, pace, share over the limit."""
from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, tzinfo
from typing import Optional, Sequence

import numpy as np

from ..core.records import Array
from ..core.units import MPH_MPS

PACE_MPS = 10 * MPH_MPS  # width of the pace: 10 mph


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """
    One pass, as read from a table.

    :param time_ns: stamp at its middle, ns.
    :param first_ns: stamp of its first pair.
    :param last_ns: stamp of its last pair.
    :param lane: name of its lane.
    :param direction: ``approaching`` or ``receding``; empty where unknown.
    :param kind: class of the vehicle; empty where unknown.
    :param speed_mps: speed; None where the pass was rejected.
    :param speed_std_mps: its 1-sigma; None likewise.
    :param reason: reason of a rejection; empty where the pass was measured.
    :param limit_mps: speed limit of its lane; None where there is none or it is unknown.
    """

    first_ns: int
    last_ns: int
    lane: str
    direction: str = ''
    kind: str = ''
    speed_mps: Optional[float] = None
    speed_std_mps: Optional[float] = None
    reason: str = ''
    limit_mps: Optional[float] = None

    @property
    def time_ns(self) -> int:
        """Return the stamp at the middle of the pass, ns."""
        return (self.first_ns + self.last_ns) // 2


@dataclass(frozen=True, kw_only=True)
class TrafficFigures:
    """
    Figures of some passes, speeds in m/s; None where no pass was measured.

    :param passes: number of passes.
    :param measured: number of measured ones; the other figures are from these.
    :param mean_mps: mean.
    :param std_mps: standard deviation; None for fewer than two.
    :param median_mps: median.
    :param p85_mps: 85th percentile: the speed that 85 % do not exceed.
    :param pace_low_mps: lower end of the pace, the 10 mph interval with the most vehicles.
    :param pace_share: share of the vehicles in the pace.
    :param max_mps: greatest speed.
    :param limited: number of vehicles on lanes with a limit.
    :param over_share: share of these above the limit, without any tolerance.
    """

    passes: int
    measured: int
    mean_mps: Optional[float] = None
    std_mps: Optional[float] = None
    median_mps: Optional[float] = None
    p85_mps: Optional[float] = None
    pace_low_mps: Optional[float] = None
    pace_share: Optional[float] = None
    max_mps: Optional[float] = None
    limited: int = 0
    over_share: Optional[float] = None


@dataclass(frozen=True, kw_only=True)
class TrafficGroup:
    """
    Figures of a group of passes.

    :param by: grouping: ``all``, ``lane``, ``direction``, ``class`` or ``hour``.
    :param group: name of the group.
    :param figures: its figures.
    """

    by: str
    group: str
    figures: TrafficFigures


def traffic_figures(vehicles: Sequence[Vehicle]) -> TrafficFigures:
    """Return the figures of some passes."""
    measured = [v for v in vehicles if v.speed_mps is not None]
    if not measured:
        return TrafficFigures(passes=len(vehicles), measured=0)
    speeds = np.sort([v.speed_mps for v in measured if v.speed_mps is not None])
    low, share = pace(speeds)
    over = [v.speed_mps > v.limit_mps for v in measured
            if v.limit_mps is not None and v.speed_mps is not None]
    return TrafficFigures(
        passes=len(vehicles), measured=len(measured), mean_mps=float(speeds.mean()),
        std_mps=float(speeds.std(ddof=1)) if len(speeds) > 1 else None,
        median_mps=float(np.median(speeds)), p85_mps=float(np.percentile(speeds, 85)),
        pace_low_mps=low, pace_share=share, max_mps=float(speeds[-1]), limited=len(over),
        over_share=sum(over) / len(over) if over else None)


def pace(speeds_mps: Array) -> tuple[float, float]:
    """
    Return the lower end, m/s, of the 10 mph interval with the most vehicles, and their share.

    The slowest of several such intervals is taken; its lower end is the speed of a vehicle.

    :param speeds_mps: (n,) rising, n >= 1.
    """
    ends = np.searchsorted(speeds_mps, speeds_mps + PACE_MPS, side='right')
    held = ends - np.arange(len(speeds_mps))
    best = int(np.argmax(held))
    return float(speeds_mps[best]), float(held[best]) / len(speeds_mps)


def traffic_groups(vehicles: Sequence[Vehicle], zone: tzinfo) -> list[TrafficGroup]:
    """
    Return the figures of all passes, then by lane, direction, class and hour of the day.

    Unknown values, such as a missing class, make no group.

    :param zone: time zone of the hours.
    """
    groups = [TrafficGroup(by='all', group='all', figures=traffic_figures(vehicles))]
    keys = {'lane': [v.lane for v in vehicles], 'direction': [v.direction for v in vehicles],
            'class': [v.kind for v in vehicles], 'hour': [_hour(v, zone) for v in vehicles]}
    for by, names in keys.items():
        for name in sorted(set(names) - {''}):
            some = [v for v, own in zip(vehicles, names) if own == name]
            groups.append(TrafficGroup(by=by, group=name, figures=traffic_figures(some)))
    return groups


def _hour(vehicle: Vehicle, zone: tzinfo) -> str:
    return f'{datetime.fromtimestamp(vehicle.time_ns // 10 ** 9, zone):%H}'
