# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A look at the rig of a node that measures, by some of its pairs."""
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
    Return how a rig stands against what is measured with, however it sways.

    :param used: what is measured with.
    :param pairs: some, spread over a while.
    :param config: what is known of roads, how lines are found, and the rig steadied.
    :param followed: how the rig has turned meanwhile, as what measures knows and allows for.
    :param suspected: how an earlier look found it.
    """
    steady, _ = steadied_pairs(used.rig, pairs, config.steadying)
    return rig_state(used, steady, config.site_refinement, config.road, followed, suspected)
