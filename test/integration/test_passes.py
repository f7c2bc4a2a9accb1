# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The topic ``passes``, over real DDS."""
from __future__ import annotations

from contextlib import ExitStack
import csv
from functools import partial
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import threading

import jsonschema
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402, I100
from geometry_msgs.msg import TwistWithCovarianceStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from stereo_speed.cli.demo import (  # noqa: E402
    EVERY_PAIR, Process, RELIABLE_IMAGES, RELIABLE_INFOS)
from stereo_speed.cli.main import main  # noqa: E402
from stereo_speed.core.units import MPH_MPS  # noqa: E402
from stereo_speed.io.pass_json import PASS_SCHEMA, TRACK_STATES_SCHEMA  # noqa: E402
from stereo_speed.lab.cli.fault_play import helper_of  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

STARTUP_S, EVENT_S = 60.0, 20.0
SILENCE = 'silence_s:=4.0'  # a busy machine may interrupt a stream for a second
ROOT = Path(__file__).resolve().parents[2]


def line_of_the_listener_of_the_readme():
    """Run the README's listener, started late, and return the first line that it prints."""
    fence = re.search(r'^```python passes.py\n(.*?)^```', (ROOT / 'README.md').read_text(),
                      re.MULTILINE | re.DOTALL)
    with subprocess.Popen([sys.executable, '-u', '-c', fence[1]], stdout=subprocess.PIPE,
                          text=True) as listener:
        guard = threading.Timer(EVENT_S, listener.kill)
        guard.start()
        try:
            return listener.stdout.readline().rstrip('\n')
        finally:
            guard.cancel()
            listener.kill()


def test_pass_is_published_at_the_end_of_the_stream_and_to_late_subscribers(
        stand_in, sample, tmp_path):
    from stereo_speed.nodes.common import LATCHED, LATEST, RELIABLE
    from stereo_speed.nodes.speeds import speed_of
    assert main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'),
                 '--out', str(tmp_path), '--no-plots']) == 0
    row, = csv.DictReader((tmp_path / 'passes.csv').open())
    tracks, states, early, lanes = [], [], [], []
    stand_in.create_subscription(Odometry, '/tracks', tracks.append, RELIABLE)
    stand_in.create_subscription(String, '/track_states', states.append, RELIABLE)
    stand_in.create_subscription(String, '/passes', early.append, LATCHED)
    healthy = set()
    stand_in.create_subscription(DiagnosticArray, '/diagnostics', lambda m: healthy.update(
        s.name.partition(':')[0] for s in m.status), RELIABLE)
    with Process('stereo_sync_node', *RELIABLE_IMAGES, *RELIABLE_INFOS), \
            Process('tracker_node', *EVERY_PAIR, *RELIABLE_INFOS, f'site:={sample / "site.yaml"}',
                    SILENCE):
        # By then the nodes have discovered the listener.
        stand_in.wait(lambda: healthy == {'stereo_sync_node', 'tracker_node'}
                      and stand_in.count_publishers('/stereo/image_pair')
                      and stand_in.count_subscribers('/stereo/image_pair')
                      and stand_in.count_subscribers('/left/camera_info') == 2, STARTUP_S)
        with Process('replay_node', f'bag:={sample / "bag"}', 'rate:=2',
                     'wait_for_topics:=stereo/image_pair'):
            stand_in.wait(lambda: early, STARTUP_S)
        late = line_of_the_listener_of_the_readme()
        stand_in.create_subscription(MarkerArray, '/lane_markers', lanes.append, LATEST)
        stand_in.wait(lambda: lanes, EVENT_S)
    assert len(early) == 1 and late == str(json.loads(early[0].data))
    assert [m.ns for m in lanes[0].markers] == ['path'] * 3  # one deletes all, two are lanes
    found = json.loads(early[0].data)
    jsonschema.validate(found, json.loads(PASS_SCHEMA.read_text()))
    assert (found['track'], found['lane'], found['first_stamp_ns'], found['last_stamp_ns']) == (
        int(row['track']), row['lane'], int(row['first_ns']), int(row['last_ns']))
    assert found['speed_mps'] == pytest.approx(float(row['speed_mps']), abs=1e-4)
    assert found['speed_std_mps'] == pytest.approx(float(row['speed_std_mps']), abs=1e-4)
    assert (found['verdict'], found['direction']) == ('measured', 'approaching')
    schema = json.loads(TRACK_STATES_SCHEMA.read_text())
    told = [json.loads(message.data) for message in states]
    for message in told:
        jsonschema.validate(message, schema)
    assert len(told) == 12  # one for each pair, with or without a vehicle
    assert [t['measured'] for m in told for t in m['tracks']] == [
        speed_of(odometry) is not None for odometry in tracks]
    assert {t['id'] for m in told for t in m['tracks']} == {found['id']}


@pytest.mark.parametrize('fault', ['info_nan', 'odd_encoding'])
def test_single_process_survives_a_bad_message_and_measures_the_pass(fault, stand_in, sample):
    """Without pair messages; one image or calibration in the middle is unusable."""
    from stereo_speed.nodes.common import LATCHED, RELIABLE
    told, readings, health = [], [], []
    stand_in.create_subscription(DiagnosticArray, '/diagnostics', health.append, RELIABLE)
    stand_in.create_subscription(String, '/passes', told.append, LATCHED)
    stand_in.create_subscription(TwistWithCovarianceStamped, '/vehicle_speed', readings.append,
                                 RELIABLE)
    with Process('speed_camera_node', *RELIABLE_IMAGES, *RELIABLE_INFOS, *EVERY_PAIR,
                 f'site:={sample / "site.yaml"}', SILENCE,
                 'visibility.reading_std_mps:=1.0') as node:
        stand_in.wait(lambda: health, STARTUP_S)  # the node has discovered its subscribers
        with Process('faulty_replay_node', f'bag:={sample / "bag"}', 'rate:=2',
                     f'fault:={fault}', 'fault_start:=0.9'):
            stand_in.wait(lambda: told and len(readings) >= 9, STARTUP_S)
            assert not node.ended()
            assert not stand_in.count_publishers('/stereo/image_pair')
    found = json.loads(told[0].data)
    assert found['verdict'] == 'measured' and found['pairs'] >= 11
    assert abs(found['speed_mps'] - 55 * MPH_MPS) < 4 * found['speed_std_mps']
    assert len(readings) >= 9
    for reading in readings[3:]:
        std = reading.twist.covariance[0] ** 0.5
        assert abs(reading.twist.twist.linear.x - 55 * MPH_MPS) < 4 * std


def test_the_processes_that_work_for_a_node_are_forks_of_it(stand_in, sample):
    """They share what it has loaded."""
    from stereo_speed.nodes.common import RELIABLE
    said = []
    stand_in.create_subscription(DiagnosticArray, '/diagnostics', lambda m: said.extend(
        s.message for s in m.status if s.name == 'tracker_node: pipeline'), RELIABLE)
    with Process('tracker_node', f'site:={sample / "site.yaml"}') as node:
        stand_in.wait(lambda: said and said[-1] != 'not configured', STARTUP_S)
        for module in 'search_process', 'pass_process':
            folder = Path('/proc') / str(helper_of(node.process.pid, module))
            assert b'stereo_speed.nodes.tracker_node' in (folder / 'cmdline').read_bytes()
            assert (folder / 'comm').read_text().strip() == module


@pytest.mark.parametrize(('module', 'fault'), [
    ('search_process', 'searches for vehicles without a separate process'),
    ('pass_process', 'measures passes without a separate process')])
def test_node_measures_without_its_helper_process_and_restarts_it(stand_in, sample, module, fault):
    """Killed before a pass, the process is missing in that pass and back in the next."""
    from stereo_speed.nodes.common import LATCHED, RELIABLE
    told, said = [], []
    stand_in.create_subscription(DiagnosticArray, '/diagnostics', lambda m: said.extend(
        s.message for s in m.status if s.name == 'speed_camera_node: pipeline'), RELIABLE)
    stand_in.create_subscription(String, '/passes', told.append, LATCHED)
    with Process('speed_camera_node', *RELIABLE_IMAGES, *RELIABLE_INFOS, *EVERY_PAIR,
                 f'site:={sample / "site.yaml"}', SILENCE) as node:
        stand_in.wait(lambda: said and said[-1] != 'not configured', STARTUP_S)
        killed = helper_of(node.process.pid, module)
        os.kill(killed, signal.SIGKILL)
        with Process('replay_node', f'bag:={sample / "bag"}', 'rate:=2'):
            stand_in.wait(lambda: told, STARTUP_S)
        stand_in.wait(lambda: any(fault in message for message in said), EVENT_S)
        stand_in.wait(lambda: fault not in said[-1], STARTUP_S)
        assert helper_of(node.process.pid, module) != killed
        with Process('replay_node', f'bag:={sample / "bag"}', 'rate:=2'):
            stand_in.wait(lambda: len(told) > 1, STARTUP_S)
        assert not node.ended()
    for found in (json.loads(message.data) for message in told):
        assert found['verdict'] == 'measured'
        assert abs(found['speed_mps'] - 55 * MPH_MPS) < 4 * found['speed_std_mps']


def test_two_rigs_in_two_namespaces_measure_alike_and_stay_separate(stand_in, sample):
    from stereo_speed.nodes.common import LATCHED, RELIABLE
    told, health = {}, []
    stand_in.create_subscription(DiagnosticArray, '/diagnostics', health.append, RELIABLE)

    def pipelines():
        return {(s.hardware_id, s.name) for m in health for s in m.status
                if s.name.endswith(': pipeline')}
    with ExitStack() as stack:
        for rig in ('/rig_a', '/rig_b'):
            stand_in.create_subscription(String, f'{rig}/passes', partial(told.__setitem__, rig),
                                         LATCHED)
            reliable = [f'qos_overrides.{rig}/{side}/{topic}.subscription.reliability:=reliable'
                        for side in ('left', 'right') for topic in ('image_raw', 'camera_info')]
            stack.enter_context(Process('speed_camera_node', *reliable, *EVERY_PAIR,
                                        f'site:={sample / "site.yaml"}', SILENCE,
                                        namespace=rig))
            stack.enter_context(Process('replay_node', f'bag:={sample / "bag"}', 'rate:=2',
                                        namespace=rig))
        stand_in.wait(lambda: len(told) == 2 and len(pipelines()) >= 2, STARTUP_S + EVENT_S)
    one, other = (json.loads(told[rig].data) for rig in ('/rig_a', '/rig_b'))
    assert one['id'] != other['id']
    assert one['speed_mps'] == pytest.approx(other['speed_mps'], abs=1e-4)
    assert pipelines() == {
        (rig, f'{rig}/speed_camera_node: pipeline') for rig in ('rig_a', 'rig_b')}
