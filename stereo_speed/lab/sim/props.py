# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Static and moving objects beside a simulated road, in its world frame."""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Optional


@dataclass(frozen=True, kw_only=True)
class PoleConfig:
    """
    A round pole that occludes vehicles behind it.

    :param ahead_m: distance ahead of the left camera, along the chord of the pass, m.
    :param right_m: distance to the camera's right of that, m.
    :param radius_m: its radius, m.
    :param height_m: its height, m.
    :param grey: its grey level in daylight.
    """

    ahead_m: float = 9.0
    right_m: float = -1.5
    radius_m: float = 0.08
    height_m: float = 9.0
    grey: float = 62.0


@dataclass(frozen=True, kw_only=True)
class PersonConfig:
    """
    A person who walks along the road.

    :param station_m: position along the road at 0 s, m.
    :param offset_m: position across it, positive to the left of travel, m.
    :param speed_mps: walking speed along the road, m/s; negative against travel.
    :param height_m: body height, m.
    :param turns_m: half the length on which the person walks back and forth, m; None to walk on.
    """

    station_m: float = 20.0
    offset_m: float = -3.8
    speed_mps: float = 1.4
    height_m: float = 1.75
    turns_m: Optional[float] = None


@dataclass(frozen=True, kw_only=True)
class TreeConfig:
    """
    A tree whose crown sways in the wind.

    :param station_m: place along the road, m.
    :param offset_m: place across it, positive to the left of travel, m.
    :param height_m: height, m.
    :param sway_m: largest swing of its top, m.
    :param period_s: period of the swing, s.
    """

    station_m: float = 10.0
    offset_m: float = 16.0
    height_m: float = 7.0
    sway_m: float = 0.25
    period_s: float = 2.6


@dataclass(frozen=True, kw_only=True)
class ParkedConfig:
    """
    A parked vehicle that shows its front.

    :param station_m: position of its front along the road, m.
    :param offset_m: position of its middle across it, positive to the left of travel, m.
    :param kind: ``car``, ``suv``, ``van``, ``truck``, ``small``, ``bus`` or ``motorcycle``.
    """

    station_m: float = 30.0
    offset_m: float = -4.4
    kind: str = 'car'


@dataclass(frozen=True, kw_only=True)
class StreetLampConfig:
    """
    A lit street lamp; its post is not drawn.

    :param station_m: place along the road, m.
    :param offset_m: place across it, positive to the left of travel, m.
    :param height_m: height of the lamp above the road, m.
    :param grey: its grey level in daylight's scale; 255 is full scale.
    """

    station_m: float = 10.0
    offset_m: float = -4.0
    height_m: float = 7.0
    grey: float = 6000.0


@dataclass(frozen=True, kw_only=True)
class LightConfig:
    """
    The light on the scene.

    :param sun_elevation_deg: height of the sun; None for a sky without sun and no cast shadows.
    :param sun_azimuth_deg: direction to the sun, anticlockwise from the direction of travel.
    :param shadow: share of the light that a cast shadow removes.
    :param headlights: whether lamps are lit and cast pools of light on the road.
    :param cloud_depth: share of the light that a cloud's shadow removes; 0 for no clouds.
    :param cloud_m: size of the clouds' shadows, m.
    :param wind_mps: speed of the clouds' shadows along and across the road, m/s.
    :param drift: largest slow change of the exposure, as a share.
    :param drift_period_s: its period, s.
    :param ambient: share of daylight on all objects except lamps.
    :param wet: wetness of the road, 0 to 1: it is darker, its markings are fainter, and it
        reflects the sky and the lamps.
    """

    sun_elevation_deg: Optional[float] = None
    sun_azimuth_deg: float = 60.0
    shadow: float = 0.5
    headlights: bool = False
    cloud_depth: float = 0.0
    cloud_m: float = 90.0
    wind_mps: tuple[float, float] = (7.0, 4.0)
    drift: float = 0.0
    drift_period_s: float = 47.0
    ambient: float = 1.0
    wet: float = 0.0

    def to_sun(self) -> Optional[tuple[float, float, float]]:
        """Return the direction to the sun: along and across the road, and up."""
        if self.sun_elevation_deg is None:
            return None
        up, azimuth = math.radians(self.sun_elevation_deg), math.radians(self.sun_azimuth_deg)
        return (math.cos(up) * math.cos(azimuth), math.cos(up) * math.sin(azimuth), math.sin(up))

    def sun(self) -> Optional[tuple[float, float]]:
        """Return the shift of a shadow per metre of height, along and across the road."""
        if self.sun_elevation_deg is None:
            return None
        reach = 1.0 / math.tan(math.radians(self.sun_elevation_deg))
        azimuth = math.radians(self.sun_azimuth_deg)
        return -reach * math.cos(azimuth), -reach * math.sin(azimuth)


OVERCAST = LightConfig(drift=0.06)
DAY = LightConfig(sun_elevation_deg=38.0, cloud_depth=0.35, drift=0.06)
DUSK = LightConfig(headlights=True, drift=0.08)
WET_NIGHT = LightConfig(headlights=True, drift=0.04, ambient=0.12, wet=1.0)
