# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Whether a rig still stands as its site was drawn: what it shows now, against what is measured with.

The lines of the road and the background are looked at anew, as refining a site does. What has
moved counts by what it would do to speeds. One look may err: what two of them find alike can be
measured with.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
import math
from typing import Iterable, Mapping, Optional

import numpy as np

from .config import RefineConfig
from .refiner import refine_site
from .speed_effect import lane_speed_std, Setup, speed_error
from ..file import Site
from ...core.errors import SiteError
from ...core.records import StereoPair
from ...geometry.rig import StereoRig
from ...road.lanes import LanePath
from ...road.problem import RoadPrior

_AS_FAR_AS_FOUND = 100.0  # sigmas: lines beside their clicks are what is asked about here
_SURELY = 4.0  # sigmas of speeds that no doubt of a site explains


@dataclass(frozen=True, eq=False)
class Stance:
    """
    How a rig stands to its road.

    :param site: the lines, and how the right camera has turned since its calibration.
    :param rig: the cameras as they stand.
    :param lanes: paths of the lanes, by their names.
    """

    site: Site
    rig: StereoRig
    lanes: Mapping[str, LanePath]


@dataclass(frozen=True)
class RigState:
    """
    How a rig stands, against what is measured with.

    :param share: greatest error of speeds that has come of what has moved, as a share of the
        speed, on the lanes that are in view; None where the images do not show it.
    :param lane: that it is the greatest on; empty where it is not known.
    :param text: what there is to say, in a few words.
    :param std_share: 1-sigma of speeds by what is uncertain of what is measured with.
    :param turned: whether the right camera is found turned, and the error is beyond doubt.
    :param stance: as the images show it; None where they do not show all of it.
    :param confirmed: whether that is how an earlier look found it.
    """

    share: Optional[float]
    lane: str
    text: str
    std_share: float = 0.0
    turned: bool = False
    stance: Optional[Stance] = field(default=None, compare=False)
    confirmed: bool = False

    def is_off(self, most_share: float) -> bool:
        """
        Return whether speeds are off; not where it is unknown.

        What the 1-sigma of a rough site covers is not off.

        :param most_share: of the speed, by which they may be where the right camera stands.
        """
        least = 0.0 if self.turned else max(most_share, _SURELY * self.std_share)
        return self.share is not None and not self.share <= least


def rig_state(used: Stance, pairs: Iterable[StereoPair], config: RefineConfig = RefineConfig(),
              prior: RoadPrior = RoadPrior(), suspected: Optional[Stance] = None,
              most_share: float = 0.01) -> RigState:
    """
    Return how a rig stands against what is measured with.

    :param used: what is measured with.
    :param pairs: some, spread over a while.
    :param config: how markings are found and believed.
    :param prior: what is known of any road and rig.
    :param suspected: how an earlier look found it.
    :param most_share: by which speeds may differ between that look and this one, as a share.
    """
    beside = replace(config, clicked_sigmas=_AS_FAR_AS_FOUND)
    try:
        now = refine_site(used.site, used.rig, pairs, beside, prior)
    except SiteError as error:
        return RigState(None, '', f'lines and background do not show how the rig stands: {error}')
    if now.kept_clicks:
        return RigState(math.inf, '', f'the rig or the lines have moved: {now.kept_clicks}')
    if not now.found:
        return RigState(None, '', 'none of the lines is seen: how the rig stands is not known')
    stance = Stance(now.site, now.rig, now.lanes)
    state = _compared(stance, used, now.drift.moved)
    again = suspected is not None and not _compared(
        stance, suspected, now.drift.moved).is_off(most_share)
    return replace(state, confirmed=again)


def _compared(now: Stance, used: Stance, turned: bool) -> RigState:
    """
    Return what has moved by what it does to speeds.

    :param now: as the rig stands.
    :param used: as it was taken to stand.
    :param turned: whether the right camera has turned since its calibration.
    """
    changes = {name: speed_error(Setup(now.lanes[name].path, now.rig), Setup(lane.path, used.rig))
               for name, lane in used.lanes.items() if name in now.lanes}
    known = {name: abs(change) for name, change in changes.items() if np.isfinite(change)}
    if not known:
        return RigState(math.inf, '', 'the road is out of view: the rig has moved')
    lane = max(known, key=lambda name: known[name])
    claimed = lane_speed_std(used.lanes[lane], used.rig)
    std = math.hypot(lane_speed_std(now.lanes[lane], now.rig), claimed)
    text = (f'rig and lines as they stand now change speeds on {lane} '
            f'by {100 * known[lane]:.2f} ± {100 * std:.2f} %')
    hidden = [name for name in used.lanes if name not in known]
    return RigState(known[lane], lane, text + (
        f'; not known of what is out of view: {", ".join(hidden)}' if hidden else ''),
        claimed, turned and known[lane] > _SURELY * std, None if hidden else now)
