# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What the profile of Fast DDS has to say for a node that was killed to be back within 2 s."""
from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

PROFILE = Path(__file__).resolve().parents[2] / 'config' / 'fastdds.xml'
SPACE = {'dds': 'http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles'}
# By default 3 s and 1 s for each of its ports; the node has 2 s for all it does.
MOST_ANNOUNCED_S, MOST_PORT_S = 0.5, 0.5


def number(path):
    found = ElementTree.parse(PROFILE).getroot().find(path, SPACE)
    assert found is not None, path
    return float(found.text)


def test_participants_announce_themselves_often():
    period = './/dds:builtin/dds:discovery_config/dds:leaseAnnouncement/dds:'
    assert 0 < number(period + 'sec') + 1e-9 * number(period + 'nanosec') <= MOST_ANNOUNCED_S


def test_ports_of_a_dead_process_are_given_up_soon_but_not_those_of_a_busy_one():
    timeout_s = 1e-3 * number('.//dds:healthy_check_timeout_ms')
    assert 0.2 <= timeout_s <= MOST_PORT_S  # a listener looks three times as often as that
