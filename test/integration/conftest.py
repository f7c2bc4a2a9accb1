# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A graph of its own for the tests: private domain, this machine only."""
from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / 'sample' / 'straight55'


@pytest.fixture(scope='session', autouse=True)
def private_graph():
    """Set before any rclpy context starts; node processes inherit it."""
    os.environ['ROS_DOMAIN_ID'] = str(20 + os.getpid() % 80)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(ROOT / 'config' / 'fastdds.xml')


@pytest.fixture()
def sample():
    """Give the sample pass that comes with the package."""
    return SAMPLE
