# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Sizes of the kinds of vehicles; all lengths in metres."""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, kw_only=True)
class BodyConfig:
    """
    Size and finish of a body; its tracked front is the rear where it recedes.

    :param kind: name of the kind; empty for a front without a body.
    :param length_m: length from front to rear, m.
    :param width_m: width of body, front and rear, m.
    :param roof_m: height of the roof, or of the load's top, above the road, m.
    :param front_m: height of the front, m.
    :param rear_m: height of the rear, m.
    :param clearance_m: height of both lower edges above the road, m.
    :param bonnet_m: length of the bonnet; 0 for none.
    :param screen_m: length of the sloping windscreen, seen from above; 0 for none.
    :param cab_m: length of a cab that is lower than the load; 0 for none.
    :param relief_m: standard deviation of the depth of the tracked front, m.
    :param contrast: scale of the grey-level detail of the tracked front; 1 as on a real vehicle.
    :param solid: whether the front is not planar: curved, with a recessed grille, protruding lamps
        and bumper, a sloping bonnet and windscreen. Its foremost part is where a planar front
        would be. Rears remain planar. Motorcycles are always solid, also from behind: their front
        plane is that of fork and headlamp, half a metre behind the tyre's foremost point.
    :param lamp_grey: grey level of the lit lamps of a solid body, in daylight's scale; 255 is
        full scale. Their beam points ahead, so that they fade where the camera is above it.
    :param gloss: gloss of a solid body's paint and glass: 0 is matt, 1 is clear lacquer.
    """

    kind: str = 'car'
    length_m: float = 4.4
    width_m: float = 1.8
    roof_m: float = 1.46
    front_m: float = 0.8
    rear_m: float = 0.85
    clearance_m: float = 0.25
    bonnet_m: float = 1.1
    screen_m: float = 0.7
    cab_m: float = 0.0
    relief_m: float = 0.0
    contrast: float = 1.0
    solid: bool = False
    lamp_grey: float = 0.0
    gloss: float = 0.0

    def tracked_m(self, rear: bool) -> float:
        """Return the height of the tracked front or rear, m."""
        return self.rear_m if rear else self.front_m


BODIES = {
    '': BodyConfig(kind='', length_m=0.0),
    'car': BodyConfig(),
    'suv': BodyConfig(kind='suv', length_m=4.7, width_m=1.9, roof_m=1.72, front_m=0.9, rear_m=1.0,
                      clearance_m=0.28, bonnet_m=1.0, screen_m=0.6),
    'van': BodyConfig(kind='van', length_m=5.6, width_m=2.0, roof_m=2.45, front_m=0.95,
                      rear_m=2.1, clearance_m=0.3, bonnet_m=0.55, screen_m=0.85),
    'truck': BodyConfig(kind='truck', length_m=9.5, width_m=2.45, roof_m=3.5, front_m=2.35,
                        rear_m=2.9, clearance_m=0.4, bonnet_m=0.0, screen_m=0.0, cab_m=2.0),
    'small': BodyConfig(kind='small', length_m=3.5, width_m=1.62, roof_m=1.5, front_m=0.72,
                        rear_m=0.95, clearance_m=0.22, bonnet_m=0.65, screen_m=0.75),
    'bus': BodyConfig(kind='bus', length_m=12.0, width_m=2.5, roof_m=3.3, front_m=2.7, rear_m=2.7,
                      clearance_m=0.3, bonnet_m=0.0, screen_m=0.1),
    'motorcycle': BodyConfig(kind='motorcycle', length_m=1.7, width_m=0.8, roof_m=1.62,
                             front_m=1.0, rear_m=1.0, clearance_m=0.35, bonnet_m=0.0,
                             screen_m=0.7, solid=True),
}


def draw_body_size(kind: str, rng: np.random.Generator) -> BodyConfig:
    """
    Draw a vehicle of a kind, with random variation of its size.

    :param kind: one of ``BODIES``.
    :param rng: source of randomness.
    """
    body = BODIES[kind]
    length, width, height = rng.normal(1.0, (0.05, 0.025, 0.03))
    return replace(
        body, length_m=body.length_m * length, width_m=body.width_m * width,
        roof_m=body.roof_m * height, front_m=body.front_m * height, rear_m=body.rear_m * height,
        clearance_m=body.clearance_m * rng.uniform(0.85, 1.15))
