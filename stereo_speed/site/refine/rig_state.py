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
from ...core.records import RigMotion, StereoPair
from ...geometry.rig import StereoRig
from ...road.lanes import LanePath
from ...road.problem import RoadPrior

MOST_SHARE = 0.01  # of the speed, by which a rig may be off: what a self-test allows
_AS_FAR_AS_FOUND = 100.0  # sigmas: lines beside their clicks are what is asked about here
_SURELY = 4.0  # sigmas of speeds beyond which a camera that was found turned has moved
_BEYOND_DOUBT = 3.0  # sigmas by which an error is greater than it may be


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
    :param std_share: 1-sigma of that error, by what is uncertain of both.
    :param turned: whether the right camera is found turned.
    :param stance: as the images show it; None where they do not show all of it well.
    :param confirmed: whether that is how an earlier look found it.
    """

    share: Optional[float]
    lane: str
    text: str
    std_share: float = 0.0
    turned: bool = False
    stance: Optional[Stance] = field(default=None, compare=False)
    confirmed: bool = False

    @property
    def is_off(self) -> bool:
        """
        Return whether speeds are off beyond doubt; not where it is unknown.

        A camera that has turned is off however little it does; lines may be by ``MOST_SHARE``.
        """
        if self.share is None:
            return False
        if self.turned and self.share > _SURELY * self.std_share:
            return True
        return not self.share <= MOST_SHARE + _BEYOND_DOUBT * self.std_share


def rig_state(used: Stance, pairs: Iterable[StereoPair], config: RefineConfig = RefineConfig(),
              prior: RoadPrior = RoadPrior(), followed: Optional[RigMotion] = None,
              suspected: Optional[Stance] = None) -> RigState:
    """
    Return how a rig stands against what is measured with.

    :param used: what is measured with.
    :param pairs: some, spread over a while, in which the rig does not sway.
    :param config: how markings are found and believed.
    :param prior: what is known of any road and rig.
    :param followed: how the rig has turned meanwhile, as what measures knows and allows for.
    :param suspected: how an earlier look found it.
    """
    # What lies beside the clicks, or contradicts them, is what is asked about here.
    beside = replace(config, clicked_sigmas=_AS_FAR_AS_FOUND, disagreement_sigmas=_AS_FAR_AS_FOUND,
                     disagreement_factor=_AS_FAR_AS_FOUND)
    try:
        now = refine_site(used.site, used.rig, pairs, beside, prior)
    except SiteError as error:
        return RigState(None, '', f'lines and background do not show how the rig stands: {error}')
    if now.kept_clicks:
        return RigState(math.inf, '', f'the rig or the lines have moved: {now.kept_clicks}')
    if not now.found:
        return RigState(None, '', 'none of the lines is seen: how the rig stands is not known')
    stance = Stance(now.site, now.rig, now.lanes)
    state = _compared(stance, replace(used, rig=used.rig.as_taken(followed)), now.drift.moved)
    again = None if suspected is None else _compared(stance, suspected, now.drift.moved)
    return replace(state, confirmed=again is not None and again.share is not None
                   and again.share <= MOST_SHARE)


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
    seen_to = max(lane_speed_std(now.lanes[name], now.rig) for name in known)
    std = math.hypot(seen_to, lane_speed_std(used.lanes[lane], used.rig))
    text = (f'rig and lines as they stand now change speeds on {lane} '
            f'by {100 * known[lane]:.2f} ± {100 * std:.2f} %')
    hidden = [name for name in used.lanes if name not in known]
    return RigState(known[lane], lane, text + (
        f'; not known of what is out of view: {", ".join(hidden)}' if hidden else ''),
        std, turned, None if hidden or seen_to > MOST_SHARE else now)
