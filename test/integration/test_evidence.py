# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Violations over real DDS: ``evidence_node`` with the other nodes."""
from __future__ import annotations

import json
from pathlib import Path
import signal
import subprocess

import cv2
import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402, I100
from rclpy.duration import Duration  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from stereo_speed.cli.demo import (  # noqa: E402
    EVERY_PAIR, Process, RELIABLE_IMAGES, RELIABLE_INFOS)
from stereo_speed.cli.main import main  # noqa: E402

STARTUP_S, RECORD_S, EVENT_S = 60.0, 180.0, 20.0


@pytest.mark.parametrize('topic', ['/passes', '/pass_traces'])
def test_node_that_is_stopped_waits_for_passes_of_nodes_that_end_with_it(
        stand_in, tmp_path, topic):
    from stereo_speed.nodes.common import LATCHED
    publisher = stand_in.create_publisher(String, topic, LATCHED)
    with Process('evidence_node', f'out:={tmp_path / "evidence"}') as node:
        stand_in.wait(lambda: publisher.get_subscription_count() == 1, STARTUP_S)
        publisher.publish(String(data='{}'))
        assert publisher.wait_for_all_acked(Duration(seconds=EVENT_S))  # it knows this process
        node.process.send_signal(signal.SIGINT)
        with pytest.raises(subprocess.TimeoutExpired):
            node.process.wait(1.0)
        stand_in.destroy_publisher(publisher)
        assert node.process.wait(EVENT_S) == 0


def _same(live, offline, where):
    """Assert equality of JSON values; numbers up to rounding, which differs between processes."""
    if isinstance(offline, dict):
        assert live.keys() == offline.keys(), where
        for key in offline:
            _same(live[key], offline[key], f'{where}.{key}')
    elif isinstance(offline, list):
        assert len(live) == len(offline), where
        for n, (a, b) in enumerate(zip(live, offline)):
            _same(a, b, f'{where}[{n}]')
    elif isinstance(offline, float):
        assert live == pytest.approx(offline, rel=1e-5, abs=1e-5), where
    else:
        assert live == offline, where


def test_live_violation_record_equals_that_of_replay(stand_in, sample, tmp_path, capsys):
    from stereo_speed.nodes.common import LATCHED
    assert main(['evidence', 'key', '--out', str(tmp_path / 'key.pem')]) == 0
    assert main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'), '--no-plots',
                 '--out', str(tmp_path / 'out'), '--evidence']) == 0
    folder, = (p for p in (tmp_path / 'out' / 'evidence').iterdir() if p.is_dir())
    offline = json.loads((folder / 'record.json').read_text())
    violations, states = [], []
    stand_in.create_subscription(String, '/violations', violations.append, LATCHED)
    stand_in.create_subscription(
        DiagnosticArray, '/diagnostics',
        lambda m: states.extend(s for s in m.status if s.name == 'evidence_node: evidence'), 10)
    with Process('stereo_sync_node', *RELIABLE_IMAGES, *RELIABLE_INFOS), \
            Process('tracker_node', *RELIABLE_INFOS, f'site:={sample / "site.yaml"}',
                    *EVERY_PAIR, 'silence_s:=5.0'), \
            Process('evidence_node', *RELIABLE_IMAGES, f'out:={tmp_path / "live"}',
                    f'key:={tmp_path / "key.pem"}'):
        stand_in.wait(lambda: stand_in.count_subscribers('/pass_traces')
                      and stand_in.count_publishers('/passes')
                      and stand_in.count_subscribers('/stereo/image_pair')
                      and stand_in.count_subscribers('/left/image_raw') >= 2, STARTUP_S)
        with Process('replay_node', f'bag:={sample / "bag"}', 'rate:=2',
                     'wait_for_topics:=stereo/image_pair pass_traces passes'):
            stand_in.wait(lambda: violations, RECORD_S)
        stand_in.wait(lambda: any(s.message == 'recording' for s in states), STARTUP_S)
    told = json.loads(violations[0].data)
    record = json.loads((Path(told['folder']) / 'record.json').read_text())
    assert len(violations) == 1 and told['id'] == record['id'] == Path(told['folder']).name
    assert (told['considered'], told['unit']) == (85, 'km/h')
    for key in ('speed', 'vehicle', 'place', 'direction', 'raw'):
        _same(record[key], offline[key], key)
    assert record['instrument']['fingerprints'] == offline['instrument']['fingerprints']
    assert record['time']['clock'] is None or 'synchronized' in record['time']['clock']
    live, replayed = (cv2.imread(str(where / row['pictures'][0]['left']), cv2.IMREAD_GRAYSCALE)
                      for where, row in ((Path(told['folder']), record), (folder, offline)))
    assert np.array_equal(live, replayed)
    assert main(['evidence', 'recompute', told['folder']]) == 0
    check = ['evidence', 'verify', str(tmp_path / 'live'), '--key', str(tmp_path / 'key.pem.pub')]
    assert main(check) == 0
    capsys.readouterr()
    (Path(told['folder']) / 'site.yaml').write_text('another')
    assert main(check) == 1
    assert 'site.yaml was changed' in capsys.readouterr().err
