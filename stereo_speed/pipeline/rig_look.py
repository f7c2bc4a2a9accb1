# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A check of the rig while a node measures, by some of its pairs."""
from __future__ import annotations

from typing import Optional, Sequence

from .assembly import steadied_pairs
from .config import SiteConfig
from ..core.records import RigMotion, StereoPair
from ..site.refine.rig_state import rig_state, RigState, Stance


def look_at_rig(used: Stance, pairs: Sequence[StereoPair], config: SiteConfig,
                followed: Optional[RigMotion] = None, suspected: Optional[Stance] = None
                ) -> RigState:
    """
    Return the state of a rig relative to the stance in use, with its sway removed.

    :param used: the stance that measuring uses.
    :param pairs: a few pairs, spread over some time.
    :param config: priors of roads, how lines are found, and how the rig is steadied.
    :param followed: rotation of the rig since, which measuring already follows and allows for.
    :param suspected: the stance that an earlier look found.
    """
    steady, _ = steadied_pairs(used.rig, pairs, config.steadying)
    return rig_state(used, steady, config.site_refinement, config.road, followed, suspected)
