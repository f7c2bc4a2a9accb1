# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A rig that does not stand still: it sways from pair to pair, and its right camera turns."""
from __future__ import annotations

from typing import Optional

import numpy as np

from .config import SimConfig
from .texture import Image
from ...core.records import RigMotion
from ...geometry.rig import StereoRig
from ...geometry.steadied import remapped


class Sway:
    """
    Draws how the rig stands in each pair.

    :param config: by how much it sways, and when its right camera turns.
    :param rng: source of the sway.
    """

    def __init__(self, config: SimConfig, rng: np.random.Generator) -> None:
        self.config, self.rng = config, rng

    def motion(self, t_s: float) -> Optional[RigMotion]:
        """
        Return how the rig stands; None where it stands as the lines of the site were clicked.

        :param t_s: when the pair is taken.
        """
        c = self.config
        pan, tilt, roll = (float(a) for a in np.radians(c.sway_deg) * self.rng.standard_normal(3))
        turned = c.right_turn_s is not None and t_s >= c.right_turn_s
        turn = [float(a) for a in np.radians(c.right_turn_deg)] if turned else [0.0, 0.0, 0.0]
        if not (c.sway_deg or any(turn)):
            return None
        return RigMotion((pan, tilt, roll), (turn[0], turn[1], turn[2]))


def swayed(image: Image, side: int, rig: StereoRig, motion: Optional[RigMotion]) -> Image:
    """
    Return an ideal image as a rig takes it that has moved.

    Each camera turns about its own centre.  What comes into view at an edge repeats the edge.

    :param image: of the rig at rest.
    :param side: 0 left, 1 right.
    :param rig: at rest.
    """
    if motion is None:
        return image
    return np.asarray(remapped(image, rig.as_taken(motion), rig, bool(side)), np.float32)
