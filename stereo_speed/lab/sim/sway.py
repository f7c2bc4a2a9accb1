# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A moving rig, which sways from pair to pair, and whose right camera turns."""
from __future__ import annotations

import math
from typing import Optional

import numpy as np

from .config import SimConfig
from .texture import Image
from ...core.records import Array, RigMotion
from ...geometry.rig import StereoRig
from ...geometry.steadied import remapped


class Sway:
    """
    Draws the rig motion of each pair.

    :param config: strength and frequency of the sway, and time of the right camera's turn.
    :param rng: source of the sway.
    """

    def __init__(self, config: SimConfig, rng: np.random.Generator) -> None:
        self.config, self.rng = config, rng
        self._phase_rad = rng.uniform(0, 2 * math.pi, 3) if config.sway_hz else np.zeros(3)

    def _angles_deg(self, t_s: float) -> Array:
        """Return pan, tilt and roll (3,) at a time: independent, or waves of one frequency."""
        c = self.config
        if not c.sway_hz:
            return c.sway_deg * self.rng.standard_normal(3)
        wave = np.sin(2 * math.pi * c.sway_hz * t_s + self._phase_rad)
        return np.asarray(math.sqrt(2) * c.sway_deg * wave)

    def motion(self, t_s: float) -> Optional[RigMotion]:
        """
        Return the rig motion relative to the clicked site; None where there is none.

        :param t_s: exposure time of the pair.
        """
        c = self.config
        pan, tilt, roll = (float(a) for a in np.radians(self._angles_deg(t_s)))
        turned = c.right_turn_s is not None and t_s >= c.right_turn_s
        turn = [float(a) for a in np.radians(c.right_turn_deg)] if turned else [0.0, 0.0, 0.0]
        if not (c.sway_deg or any(turn)):
            return None
        return RigMotion((pan, tilt, roll), (turn[0], turn[1], turn[2]))


def swayed(image: Image, side: int, rig: StereoRig, motion: Optional[RigMotion]) -> Image:
    """
    Return an ideal image as seen by a rig that has moved.

    Each camera turns about its own centre.  New regions at a border repeat the edge pixels.

    :param image: image of the rig at rest.
    :param side: 0 left, 1 right.
    :param rig: the rig at rest.
    """
    if motion is None:
        return image
    return np.asarray(remapped(image, rig.as_taken(motion), rig, bool(side)), np.float32)
