# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A third-party package with a tracker and a detector for stereo_speed."""
from setuptools import setup

setup(
    name='outside_speed',
    version='1.0',
    py_modules=['outside_speed'],
    entry_points={
        'stereo_speed.trackers': ['outside_clock = outside_speed:ClockTracker'],
        'stereo_speed.detectors': ['outside_gate = outside_speed:GateDetector'],
    },
)
