# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The live rig against its site: a node checks it in a separate process."""
from __future__ import annotations

import json

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402, I100
from scipy.spatial.transform import Rotation  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from stereo_speed.cli.demo import (  # noqa: E402
    EVERY_PAIR, Process, RELIABLE_IMAGES, RELIABLE_INFOS)
from stereo_speed.core.units import MPH_MPS  # noqa: E402
import yaml  # noqa: E402

STARTUP_S, LOOK_S = 60.0, 480.0
AT_ONCE = 'rig_check_niceness:=0'  # not when other tests leave a core idle
TURNED_DEG, TRUE_MPH = 0.05, 55.0  # 6 % of the speed
PAIRS = 12  # the whole bag, so that it does not matter where in its loop a check begins


def heard_of(stand_in):
    """Return the list to which reports on the rig are appended."""
    states = []
    stand_in.create_subscription(
        DiagnosticArray, '/diagnostics',
        lambda m: states.extend(s for s in m.status if s.name.endswith(': rig')), 10)
    return states


def turned(topic, _, msg):
    """Return a message of the sample with the calibration before its right camera turned."""
    if topic.endswith('right/camera_info'):
        before = Rotation.from_euler('y', TURNED_DEG, degrees=True).as_matrix()
        msg.r = (msg.r.reshape(3, 3) @ before).ravel()
    return msg


def of_one_lane(sample, path):
    """Write the site with one lane of the sample, which is checked ten times as fast."""
    site = yaml.safe_load((sample / 'site.yaml').read_text())
    del site['lines']['edge_left'], site['lanes'][1]
    path.write_text(yaml.safe_dump(site))
    return path


def test_check_of_the_rig_is_reported(stand_in, sample):
    states = heard_of(stand_in)
    with Process('speed_camera_node', *RELIABLE_IMAGES, *RELIABLE_INFOS, *EVERY_PAIR,
                 f'site:={sample / "site.yaml"}', 'rig_check_interval_s:=3600',
                 'rig_check_pairs:=4', 'rig_check_spread_s:=0.0', AT_ONCE):
        stand_in.wait(lambda: stand_in.count_subscribers('/left/image_raw'), STARTUP_S)
        with Process('replay_node', f'bag:={sample / "bag"}', 'rate:=2'):
            stand_in.wait(lambda: states and states[-1].message.startswith('the present pose'),
                          LOOK_S)
    assert states[-1].level == b'\x00'


def test_rotated_camera_is_noticed_and_then_corrected(stand_in, sample, rewrite, tmp_path):
    from stereo_speed.nodes.common import LATCHED
    states, passes = heard_of(stand_in), []
    stand_in.create_subscription(
        String, 'passes', lambda m: passes.append(json.loads(m.data)), LATCHED)
    bag = rewrite(tmp_path / 'bag', turned, 1000)
    site = of_one_lane(sample, tmp_path / 'one.yaml')
    with Process('speed_camera_node', *RELIABLE_IMAGES, *RELIABLE_INFOS, *EVERY_PAIR,
                 f'site:={site}', 'rig_check_interval_s:=3600',
                 f'rig_check_pairs:={PAIRS}', 'rig_check_spread_s:=0.0', AT_ONCE):
        stand_in.wait(lambda: stand_in.count_subscribers('/left/image_raw'), STARTUP_S)
        with Process('replay_node', f'bag:={bag}', 'loop:=true', 'rate:=0.25'):
            stand_in.wait(lambda: any('two checks' in s.message for s in states), LOOK_S)
            before = len(passes)
            stand_in.wait(lambda: any(p['verdict'] == 'measured' for p in passes[before:]),
                          LOOK_S)
    assert any(s.level == b'\x02' and 'nothing is measured' in s.message for s in states)
    last = next(p for p in passes[before:] if p['verdict'] == 'measured')
    error_mph = last['speed_mps'] / MPH_MPS - TRUE_MPH
    assert abs(error_mph) < min(1.0, 4 * last['speed_std_mps'] / MPH_MPS)
