# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Real node processes over real DDS."""
from __future__ import annotations

import csv
import signal
import subprocess
import sys

import pytest

pytest.importorskip('rclpy')

from sensor_msgs.msg import CameraInfo, Image  # noqa: E402

from stereo_speed.cli.demo import (  # noqa: E402
    EVERY_PAIR, live, Process, RELIABLE_IMAGES, RELIABLE_INFOS, WHOLE_CHAIN)
from stereo_speed.cli.main import main  # noqa: E402
from stereo_speed.core.units import MPH_MPS  # noqa: E402
from stereo_speed.io.truth import read_truth  # noqa: E402

STARTUP_S, EVENT_S = 60.0, 20.0
PATIENT = 'silence_s:=60'  # a pause of a busy machine is not the end of the stream
pytestmark = pytest.mark.usefixtures('private_graph')


def test_live_readings_equal_replay(sample, tmp_path):
    """Also for a site with its own tolerances."""
    site = tmp_path / 'own.yaml'
    site.write_text((sample / 'site.yaml').read_text() + 'tolerances: {focal_std: 0.003}\n')
    assert main(['replay', str(sample / 'bag'), '--site', str(site), '--init',
                 str(sample / 'init.yaml'), '--out', str(tmp_path), '--no-plots']) == 0
    rows = list(csv.DictReader((tmp_path / 'tracks.csv').open()))
    wanted = {int(r['stamp_ns']): r for r in rows if r['state'] == 'confirmed'}
    readings, frames = live(sample, site, len(wanted), 2.0,
                            read_truth(sample / 'truth.csv')[0],
                            parameters=[f'init:={sample / "init.yaml"}', PATIENT,
                                        'overlay_hz:=1000'])
    assert [r[0] for r in readings] == sorted(wanted)
    for ns, vehicle, speed, std in readings:
        assert vehicle == 'vehicle_' + wanted[ns]['track']
        assert speed == pytest.approx(float(wanted[ns]['speed_mps']), abs=1e-5)
        assert std == pytest.approx(float(wanted[ns]['speed_std_mps']), abs=1e-5)
    stamps = {int(r['stamp_ns']) for r in rows}  # confirmed or not
    assert frames and set(frames) <= stamps  # a pair that comes during a drawing is not drawn


@pytest.mark.parametrize('node, parameters, words', [
    ('tracker_node', ['site:={bad}', 'init:={init}'], ['site.yaml', 'lanez']),
    ('tracker_node', ['init:={init}'], ['site', 'nothing']),
    ('tracker_node', ['site:={site}', 'init:={init}', 'particles:=3'], ['particles']),
    ('replay_node', ['bag:={init}/none'], ['none']),
    ('stereo_sync_node', ['image_transport:=theora'], ['image_transport', 'theora']),
    ('stereo_sync_node', ['approximate_sync:=true'],
     ['approximate_sync_tolerance_seconds', 'more than 0']),
])
def test_bad_input_ends_a_node_with_one_line(node, parameters, words, sample, tmp_path):
    bad = tmp_path / 'site.yaml'
    bad.write_text((sample / 'site.yaml').read_text().replace('lanes:', 'lanez:'))
    values = {'bad': bad, 'init': sample / 'init.yaml', 'site': sample / 'site.yaml'}
    command = [sys.executable, '-m', f'stereo_speed.nodes.{node}', '--ros-args']
    command += [w for p in parameters for w in ('-p', p.format(**values))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=STARTUP_S)
    lines = [x for x in done.stderr.splitlines() if x.strip()]
    assert done.returncode == 2, done.stderr
    assert len(lines) == 1 and lines[0].startswith('error: '), done.stderr
    assert all(w in lines[0] for w in words), lines[0]


def test_looping_replay_gives_new_vehicles_with_the_same_speeds(sample):
    """A looping replay: stamps and clock jump back, and measuring starts again."""
    from stereo_speed.nodes.demo_listener import Listener
    readings = []
    listener = Listener(lambda *reading: readings.append(reading), lambda *frame: None)
    try:
        with Process('stereo_sync_node', *RELIABLE_IMAGES, *RELIABLE_INFOS), \
                Process('speed_node'), \
                Process('tracker_node', *EVERY_PAIR, *RELIABLE_INFOS, PATIENT,
                        f'site:={sample / "site.yaml"}',
                        f'init:={sample / "init.yaml"}', 'use_sim_time:=true'):
            assert listener.spin(STARTUP_S, lambda: not listener.missing_wires())
            listener.spin(0.5, lambda: False)
            with Process('replay_node', f'bag:={sample / "bag"}', WHOLE_CHAIN, 'rate:=1',
                         'loop:=true'):
                assert listener.spin(STARTUP_S, lambda: len(readings) >= 20)
    finally:
        listener.close()
    first = [r for r in readings if r[1] == 'vehicle_0']
    second = [r for r in readings if r[1] == 'vehicle_1']
    assert len(first) == 10 and len(second) >= 10
    assert [r[0] for r in first] == [r[0] for r in second[:10]]
    # Another track draws other particles; the images are the same.
    for a, b in zip(first[4:], second[4:10]):
        assert a[2] == pytest.approx(b[2], abs=0.1)


def test_vehicles_at_a_site_refined_at_start_equal_replay(sample, tmp_path):
    """Without annotations: the node refines the site with its first pairs and detects."""
    from stereo_speed.nodes.demo_listener import Listener
    assert main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'),
                 '--refine-site', '--out', str(tmp_path), '--no-plots']) == 0
    rows = list(csv.DictReader((tmp_path / 'tracks.csv').open()))
    wanted = {int(r['stamp_ns']): r for r in rows if r['state'] == 'confirmed'}
    readings = []
    listener = Listener(lambda *reading: readings.append(reading), lambda *frame: None)
    try:
        with Process('stereo_sync_node', *RELIABLE_IMAGES, *RELIABLE_INFOS), \
                Process('speed_node'), \
                Process('tracker_node', *EVERY_PAIR, *RELIABLE_INFOS, PATIENT,
                        f'site:={sample / "site.yaml"}',
                        'refine_site_pairs:=12'):
            assert listener.spin(STARTUP_S, lambda: not listener.missing_wires())
            listener.spin(0.5, lambda: False)
            with Process('replay_node', f'bag:={sample / "bag"}', WHOLE_CHAIN, 'rate:=5'):
                assert listener.spin(STARTUP_S, lambda: len(readings) >= len(wanted))
    finally:
        listener.close()
    assert [r[0] for r in readings] == sorted(wanted)
    for ns, vehicle, speed, std in readings:
        assert vehicle == 'vehicle_' + wanted[ns]['track']
        assert speed == pytest.approx(float(wanted[ns]['speed_mps']), abs=1e-5)
        assert std == pytest.approx(float(wanted[ns]['speed_std_mps']), abs=1e-5)


def test_boxes_of_another_node_become_vehicles(sample, sample_boxes, stand_in):
    """Boxes as from a neural network's node; stereo measures the vehicle."""
    from sensor_msgs.msg import PointCloud2
    from std_msgs.msg import Header
    from stereo_speed.detection.protocol import ImageBox
    from stereo_speed.nodes.boxes import boxes_message
    from stereo_speed.nodes.common import RELIABLE, to_stamp
    from stereo_speed.nodes.demo_listener import Listener
    readings = []
    listener = Listener(lambda *reading: readings.append(reading), lambda *frame: None)
    publisher = stand_in.create_publisher(PointCloud2, 'boxes', RELIABLE)
    try:
        with Process('stereo_sync_node', *RELIABLE_IMAGES, *RELIABLE_INFOS), \
                Process('speed_node'), \
                Process('tracker_node', *EVERY_PAIR, *RELIABLE_INFOS, PATIENT,
                        f'site:={sample / "site.yaml"}',
                        'detector:=boxes'):
            assert listener.spin(STARTUP_S, lambda: not listener.missing_wires())
            stand_in.wait(lambda: publisher.get_subscription_count() == 1, STARTUP_S)
            for ns, (left, top, width, height) in sample_boxes.items():
                publisher.publish(boxes_message(
                    [ImageBox(left_px=left, top_px=top, width_px=width, height_px=height)],
                    Header(stamp=to_stamp(ns))))
            with Process('replay_node', f'bag:={sample / "bag"}', WHOLE_CHAIN, 'rate:=2'):
                assert listener.spin(STARTUP_S, lambda: len(readings) >= 5)
    finally:
        listener.close()
    for _, vehicle, speed, std in readings[-3:]:
        assert vehicle == 'vehicle_0' and abs(speed / MPH_MPS - 55.0) < 4 * std / MPH_MPS


def test_interrupted_node_publishes_its_open_passes_first(sample):
    from stereo_speed.nodes.demo_listener import Listener
    readings = []
    listener = Listener(lambda *reading: readings.append(reading), lambda *frame: None)
    command = [sys.executable, '-m', 'stereo_speed.nodes.tracker_node', '--ros-args']
    for parameter in (f'site:={sample / "site.yaml"}', f'init:={sample / "init.yaml"}',
                      *EVERY_PAIR, PATIENT, *RELIABLE_INFOS):
        command += ['-p', parameter]
    tracker = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        with Process('stereo_sync_node', *RELIABLE_IMAGES, *RELIABLE_INFOS), \
                Process('speed_node'):
            assert listener.spin(STARTUP_S, lambda: not listener.missing_wires())
            with Process('replay_node', f'bag:={sample / "bag"}', WHOLE_CHAIN, 'rate:=2',
                         'loop:=true'):
                assert listener.spin(STARTUP_S, lambda: len(readings) >= 4)
                tracker.send_signal(signal.SIGINT)
                out, log = tracker.communicate(timeout=EVENT_S)
    finally:
        listener.close()
        if tracker.poll() is None:
            tracker.kill()
            tracker.communicate()
    assert tracker.returncode == 0, log
    assert 'vehicle_0 on lane_0' in out + log and 'context is invalid' not in out + log, log


@pytest.fixture()
def rig_node(stand_in):
    """Return a stand-in for the cameras that receives the pairs."""
    from stereo_speed.nodes.common import RELIABLE
    node = stand_in
    node.send = {side: node.create_publisher(Image, f'/{side}/image_raw', RELIABLE)
                 for side in ('left', 'right')}
    node.infos = {side: node.create_publisher(CameraInfo, f'/{side}/camera_info', RELIABLE)
                  for side in ('left', 'right')}
    node.pairs = []
    node.create_subscription(Image, '/stereo/image_pair', node.pairs.append, RELIABLE)
    return node


def image(ns, value):
    import numpy as np
    from stereo_speed.nodes.common import image_message
    return image_message(np.full((4, 6), value, np.uint8), ns=ns, frame_id='left_optical')


def test_sync_pairs_equal_stamps_counts_the_rest_and_survives_a_jump(rig_node):
    from diagnostic_msgs.msg import DiagnosticArray
    import numpy as np
    from stereo_speed.nodes.common import stamp_ns
    counts = {}

    def on_diagnostics(msg):
        counts.update({v.key: v.value for s in msg.status for v in s.values})
    rig_node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 10)
    second = 1_000_000_000
    with Process('stereo_sync_node', *RELIABLE_IMAGES, *RELIABLE_INFOS):
        rig_node.wait(lambda: all(p.get_subscription_count() for p in rig_node.send.values())
                      and counts, STARTUP_S)  # subscribers are discovered
        for ns in (100 * second, 101 * second, 102 * second):
            rig_node.send['left'].publish(image(ns, 10))
            if ns != 101 * second:  # one right image is lost on the way
                rig_node.send['right'].publish(image(ns, 20))
        rig_node.wait(lambda: len(rig_node.pairs) == 2, EVENT_S)
        rig_node.send['left'].publish(image(5 * second, 30))  # time jumps back
        rig_node.send['right'].publish(image(5 * second, 40))
        rig_node.wait(lambda: len(rig_node.pairs) == 3, EVENT_S)
        rig_node.wait(lambda: counts.get('pairs') == '3', EVENT_S)
    assert [stamp_ns(p.header.stamp) // second for p in rig_node.pairs] == [100, 102, 5]
    pair = rig_node.pairs[-1]
    assert (pair.height, pair.width, pair.encoding) == (8, 6, 'mono8')
    pixels = np.frombuffer(pair.data, np.uint8).reshape(8, pair.step)[:, :6]
    assert pixels.tolist() == [[30] * 6] * 4 + [[40] * 6] * 4
    assert pair.header.frame_id == 'left_optical'
    assert counts['unpaired_left'] == '1' and counts['unpaired_right'] == '0'


def test_unusable_image_is_refused_and_the_next_good_pair_is_taken(rig_node):
    from diagnostic_msgs.msg import DiagnosticArray
    from diagnostic_msgs.msg import DiagnosticStatus
    import numpy as np
    from stereo_speed.nodes.common import image_message, stamp_ns
    states = []
    rig_node.create_subscription(
        DiagnosticArray, '/diagnostics',
        lambda msg: states.extend(s for s in msg.status if s.name == 'stereo_sync_node: pairs'),
        10)
    command = [sys.executable, '-m', 'stereo_speed.nodes.stereo_sync_node', '--ros-args']
    for given in (*RELIABLE_IMAGES, *RELIABLE_INFOS):
        command += ['-p', given]
    node = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    period = 50_000_000
    short = image(101 * period, 1)
    short.data = short.data[:10]
    odd = image(103 * period, 1)
    odd.encoding = 'yuv422'
    bad = {101: short, 102: image_message(np.ones((5, 6), np.uint8), ns=102 * period,
                                          frame_id='left_optical'),
           103: odd, 104: Image(encoding='mono8')}
    try:
        rig_node.wait(lambda: all(p.get_subscription_count() for p in
                                  [*rig_node.send.values(), *rig_node.infos.values()])
                      and rig_node.count_publishers('/stereo/image_pair'), STARTUP_S)
        rig_node.infos['left'].publish(CameraInfo(width=6, height=4))
        rig_node.wait(lambda: states, EVENT_S)
        for k in range(100, 106):
            rig_node.send['left'].publish(bad.get(k, image(k * period, k)))
            rig_node.send['right'].publish(image(k * period, k))
        rig_node.wait(lambda: len(rig_node.pairs) == 2, EVENT_S)
        rig_node.wait(lambda: {('refused', '4'), ('unpaired_right', '4')} <= {
            (v.key, v.value) for v in states[-1].values}, EVENT_S)
        rig_node.wait(lambda: any('refused' in s.message and s.level == DiagnosticStatus.WARN
                                  for s in states), EVENT_S)
        assert node.poll() is None
    finally:
        node.send_signal(signal.SIGINT)
        log = node.communicate(timeout=EVENT_S)[1]
    assert node.returncode == 0
    assert [stamp_ns(p.header.stamp) // period for p in rig_node.pairs] == [100, 105]
    # At most one line a second, of which a busy machine may need several.
    assert 'refused: left/image_raw: image data: found 10 bytes, wanted 24 bytes' in log, log
