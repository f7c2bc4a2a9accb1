# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Whether a rig still stands as its site was drawn: what it shows now, against what is measured with.

The lines of the road and the background are looked at anew, as refining a site does. What has
moved counts by what it would do to speeds.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Iterable, Mapping, Optional

import numpy as np

from .config import RefineConfig
from .refiner import refine_site
from .speed_effect import Setup, speed_error
from ..file import Site
from ...core.errors import SiteError
from ...core.records import StereoPair
from ...geometry.rig import StereoRig
from ...road.lanes import LanePath
from ...road.problem import RoadPrior

_AS_FAR_AS_FOUND = 100.0  # sigmas: lines beside their clicks are what is asked about here


@dataclass(frozen=True)
class RigState:
    """
    How a rig stands.

    :param share: greatest error of speeds that has come of what has moved, as a share of the
        speed, on the lanes that are in view; None where the images do not show it.
    :param lane: that it is the greatest on; empty where it is not known.
    :param text: what there is to say, in a few words.
    """

    share: Optional[float]
    lane: str
    text: str

    def is_off(self, most_share: float) -> bool:
        """Return whether speeds are off by more than a share of them; not where it is unknown."""
        return self.share is not None and not self.share <= most_share


def rig_state(site: Site, rig: StereoRig, lanes: Mapping[str, LanePath],
              pairs: Iterable[StereoPair], config: RefineConfig = RefineConfig(),
              prior: RoadPrior = RoadPrior()) -> RigState:
    """
    Return how a rig stands against what is measured with.

    :param site: that is measured at.
    :param rig: that is measured with.
    :param lanes: paths that are measured along.
    :param pairs: some, spread over a while.
    :param config: how markings are found and believed.
    :param prior: what is known of any road and rig.
    """
    beside = replace(config, clicked_sigmas=_AS_FAR_AS_FOUND)
    try:
        now = refine_site(site, rig, pairs, beside, prior)
    except SiteError as error:
        return RigState(None, '', f'lines and background do not show how the rig stands: {error}')
    if now.kept_clicks:
        return RigState(math.inf, '', f'the rig or the lines have moved: {now.kept_clicks}')
    if not now.found:
        return RigState(None, '', 'none of the lines is seen: how the rig stands is not known')
    shares = {name: abs(speed_error(Setup(now.lanes[name].path, now.rig), Setup(lane.path, rig)))
              for name, lane in lanes.items() if name in now.lanes}
    known = {name: share for name, share in shares.items() if np.isfinite(share)}
    if not known:
        return RigState(math.inf, '', 'the road is out of view: the rig has moved')
    lane = max(known, key=lambda name: known[name])
    text = (f'rig and lines as they stand now change speeds on {lane} '
            f'by {100 * known[lane]:.2f} %')
    hidden = [name for name in lanes if name not in known]
    return RigState(known[lane], lane, text + (
        f'; not known of what is out of view: {", ".join(hidden)}' if hidden else ''))
