# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Contradictions between the clicks of a site and the markings that were found."""
from __future__ import annotations

import math
from typing import Mapping, NamedTuple, Optional

import numpy as np

from .clicked import Clicks, scatter_px
from .config import RefineConfig
from .markings import Found
from .speed_effect import lane_speed_std, Setup, speed_error
from ..file import MOST_PATH_STD, Site
from ..lane_paths import lane_paths
from ...core.errors import SiteError
from ...core.records import Array
from ...geometry.rig import StereoRig
from ...road.fitted import RoadFit
from ...road.lanes import LanePath
from ...road.problem import RoadPrior


class KeptClicks(NamedTuple):
    """
    Why the lines stay as clicked.

    :param reason: the reason as text.
    :param path_std: relative 1-sigma of speeds on each lane that follows from it; empty if
        nothing does.
    """

    reason: str
    path_std: Mapping[str, float]


def off_road_px(road: RoadFit, rough: Site, found: Found) -> Array:
    """Return how far (n,) all clicks scatter about their lines on a refined road, px."""
    return scatter_px(road, {
        name: Clicks(found[name][0].shape.width_m if name in found else 0.0,
                     rough.picked[name].views_px)
        for name in rough.picked if name in road.names})


def disagreement(lanes: Mapping[str, LanePath], clicked: Site, rig: StereoRig, off_px: Array,
                 config: RefineConfig, prior: RoadPrior) -> Optional[KeptClicks]:
    """
    Return how refined lanes contradict the clicks; None if they do not.

    As it is unknown which of them are wrong, speeds by the clicks are as uncertain as they differ.

    Lines about which the clicks scatter as clicks do are no contradiction, even if a road fitted
    to the clicks alone is far off.

    :param clicked: site with the lines as clicked, and with the correction of the rig.
    :param rig: rig with the correction applied.
    :param off_px: (n,) as of :func:`off_road_px`.
    """
    try:
        rough = lane_paths(clicked, rig, prior)
    except SiteError:
        return None
    most_px = config.disagreement_factor * max(
        [prior.pick_std_px, *(lane.residual_px for lane in rough.values())])
    if len(off_px) and np.sqrt(np.mean(np.square(off_px))) < most_px:
        return None
    changes = {name: _change(lane, rough[name], rig) for name, lane in lanes.items()}
    for name, lane in lanes.items():
        std = math.hypot(*(lane_speed_std(each, rig) for each in (lane, rough[name])))
        if abs(changes[name]) > config.disagreement_sigmas * std:
            return KeptClicks(
                f'speeds on {name} by the detected markings and by the clicks differ by '
                f'{100 * changes[name]:+.2f} %, {abs(changes[name]) / std:.1f} combined sigmas',
                {key: float(min(abs(change), MOST_PATH_STD)) for key, change in changes.items()})
    return None


def _change(lane: LanePath, other: LanePath, rig: StereoRig) -> float:
    """Return the relative difference of speeds along two paths of a lane, the larger one."""
    setups = Setup(lane.path, rig), Setup(other.path, rig)
    return max((float(np.nan_to_num(speed_error(a, b))) for a, b in (setups, setups[::-1])),
               key=abs)
