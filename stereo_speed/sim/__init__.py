# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated stereo sequences with exact truth."""
from __future__ import annotations

from .config import (
    circle_config, RigConfig, RIGS, RoadConfig, SimConfig, straight_config, VehicleConfig)
from .sequence import SimSequence, simulate

__all__ = [
    'RIGS', 'RigConfig', 'RoadConfig', 'SimConfig', 'SimSequence', 'VehicleConfig',
    'circle_config', 'simulate', 'straight_config']
