# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated stereo sequences with exact truth."""
from __future__ import annotations

from .config import (
    circle_config, RigConfig, RIGS, RoadConfig, SimConfig, straight_config, VehicleConfig)
from .optics import FaultConfig, LensConfig
from .props import (
    DAY, DUSK, LightConfig, OVERCAST, ParkedConfig, PersonConfig, PoleConfig, StreetLampConfig,
    TreeConfig, WET_NIGHT)
from .sequence import SimSequence, simulate
from .traffic import TrafficPair, TrafficStream
from .traffic_config import traffic_config, TrafficConfig

__all__ = [
    'DAY', 'DUSK', 'FaultConfig', 'LensConfig', 'LightConfig', 'OVERCAST', 'ParkedConfig',
    'PersonConfig', 'PoleConfig', 'RIGS', 'RigConfig', 'RoadConfig', 'SimConfig', 'SimSequence',
    'StreetLampConfig', 'TrafficConfig', 'TrafficPair', 'TrafficStream', 'TreeConfig',
    'VehicleConfig', 'WET_NIGHT', 'circle_config', 'simulate', 'straight_config',
    'traffic_config']
