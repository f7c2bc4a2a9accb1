# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``environment_node`` as a real process over DDS, against the command on the same frames."""
from __future__ import annotations

import csv
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402, I100
from geometry_msgs.msg import Point32, PolygonStamped  # noqa: E402
from sensor_msgs.msg import Image, PointCloud2  # noqa: E402
from stereo_speed.cli.demo import Process  # noqa: E402
from stereo_speed.cli.main import main  # noqa: E402
from stereo_speed.core.errors import InputError  # noqa: E402
from stereo_speed.monocular.boxes import corners, TargetState  # noqa: E402
from stereo_speed.nodes.common import (  # noqa: E402
    image_message, RELIABLE, stamp_ns, to_stamp)
from stereo_speed.nodes.environment_messages import RECORD  # noqa: E402
from stereo_speed.nodes.environment_node import EnvironmentNode  # noqa: E402
from stereo_speed.nodes.health import Arrivals, OK, Refusals, Tally, WARN, WINDOW_S  # noqa: E402
from stereo_speed.nodes.marks import target_from_message  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

pytestmark = pytest.mark.usefixtures('private_graph')
STARTUP_S, EVENT_S = 60.0, 60.0
FRAMES, PERIOD_NS = 8, 200_000_000  # the video is longer than the limit for late images
EARLIER_NS = 10 ** 12  # stamps of what is sent before the video; it jumps back to its own
BOX = (30, 40, 12, 30)


def frames():
    """Draw a red person who walks to the right over a textured ground."""
    noise = np.random.default_rng(1).normal(110, 20, (120, 160, 3))
    ground = cv2.GaussianBlur(noise, (0, 0), 1.0).clip(0, 255).astype(np.uint8)
    for number in range(FRAMES):
        image = ground.copy()
        x = BOX[0] + 3 * number
        image[BOX[1]:BOX[1] + BOX[3], x:x + BOX[2]] = (40, 40, 210)
        yield image


@pytest.fixture(scope='module')
def scene(tmp_path_factory):
    """Write the frames, a map and the mark."""
    folder = tmp_path_factory.mktemp('scene')
    (folder / 'video').mkdir()
    for number, image in enumerate(frames(), 1):
        cv2.imwrite(str(folder / 'video' / f'{number}.png'), image)
    labels = np.full((120, 160), 128, np.uint8)
    labels[50:90] = 255
    cv2.imwrite(str(folder / 'map.png'), labels)
    (folder / 'targets.yaml').write_text(
        f'environment_targets: 1\ntargets:\n- {{id: 3, frame: 2, box: '
        f'[{BOX[0] + 3}, {BOX[1]}, {BOX[2]}, {BOX[3]}]}}\n')
    return folder


@pytest.fixture()
def camera(stand_in):
    """Stand in for the camera and listen to the node."""
    node = stand_in
    node.images = node.create_publisher(Image, '/image_raw', RELIABLE)
    node.tracks, node.markers, node.overlays = [], [], []
    for kind, topic, heard in ((PointCloud2, '/tracks', node.tracks),
                               (MarkerArray, '/markers', node.markers),
                               (Image, '/overlay/image_raw', node.overlays)):
        node.create_subscription(kind, topic, heard.append, RELIABLE)
    node.ready = lambda: node.images.get_subscription_count() and all(
        node.count_publishers(t) for t in ('/tracks', '/markers', '/overlay/image_raw'))
    return node


def settle(camera):
    """Send frames of another time until all listeners have received one."""
    image, sent = next(frames()), []

    def heard_everywhere():
        if not sent or time.monotonic() > sent[-1] + 0.5:
            sent.append(time.monotonic())
            camera.images.publish(image_message(image, ns=EARLIER_NS + len(sent) * PERIOD_NS,
                                                frame_id='camera_optical'))
        return camera.tracks and camera.markers and camera.overlays
    camera.wait(heard_everywhere, STARTUP_S)


def of_video(heard):
    """Drop what was received before the video began."""
    return [m for m in heard if stamp_ns(m.header.stamp) < EARLIER_NS]


def drawn(camera, number):
    """Return the markers of a frame of the video, each time it was published."""
    return [m.markers for m in camera.markers if m.markers
            and stamp_ns(m.markers[0].header.stamp) == number * PERIOD_NS]


def parameters(scene, **more):
    values = {'map': scene / 'map.png', 'targets': scene / 'targets.yaml', 'seed': 4,
              'qos_overrides./image_raw.subscription.reliability': 'reliable', **more}
    return [f'{name}:={value}' for name, value in values.items()]


def test_live_tracks_equal_the_command_and_a_jump_starts_anew(scene, camera, tmp_path):
    assert main(['track-environment', str(scene / 'video'), '--map', str(scene / 'map.png'),
                 '--init', str(scene / 'targets.yaml'), '--out', str(tmp_path), '--seed',
                 '4']) == 0
    wanted = {int(r['frame']): r for r in csv.DictReader((tmp_path / 'targets.csv').open())}
    assert sorted(wanted) == list(range(2, FRAMES + 1))
    with Process('environment_node', *parameters(scene)):
        camera.wait(camera.ready, STARTUP_S)
        settle(camera)
        for count in range(2):  # the second time the stamps jump back
            for number, image in enumerate(frames(), 1):
                camera.images.publish(image_message(image, ns=number * PERIOD_NS,
                                                    frame_id='camera_optical'))
                # A camera is slower than the node; a burst would overrun the queue of either.
                heard = count * FRAMES + number
                camera.wait(lambda: len(of_video(camera.tracks)) == heard, EVENT_S)
        camera.wait(lambda: len(of_video(camera.tracks)) == len(of_video(camera.overlays))
                    == 2 * FRAMES and drawn(camera, FRAMES), EVENT_S)
    for index, message in enumerate(of_video(camera.tracks)):
        number = index % FRAMES + 1
        assert stamp_ns(message.header.stamp) == number * PERIOD_NS
        assert message.header.frame_id == 'camera_optical'
        rows = np.frombuffer(bytes(message.data), RECORD)
        if number not in wanted:
            assert len(rows) == 0
            continue
        row, want = rows[0], wanted[number]
        assert row['id'] == 3 and not row['hidden']
        for name, column in (('left', 'x'), ('top', 'y'), ('width', 'w'), ('height', 'h'),
                             ('d_px', 'd_px'), ('d_rate_px', 'd_rate_px')):
            assert row[name] == pytest.approx(float(want[column]), abs=2e-3)
        assert [f.name for f in message.fields] == list(RECORD.names)
        # viewers show the middle of the lower edge
        assert row['x'] == pytest.approx(row['left'] + row['width'] / 2, abs=1e-3)
    outline, text = drawn(camera, FRAMES)[0]
    assert len(outline.points) == 5 and text.text.startswith('3 ')
    assert (camera.overlays[0].height, camera.overlays[0].width) == (120, 160)


def values_of(told):
    """Return the newest values of the node on /diagnostics."""
    found = [s for m in told for s in m.status if s.name.startswith('environment_node')]
    return {v.key: v.value for v in found[-1].values} if found else {}


def test_target_marked_late_is_tracked_as_if_marked_in_time(scene, camera, tmp_path):
    """Marked after frame 4, by the stamp of frame 2; a mark of no frame is refused."""
    (tmp_path / 'one.yaml').write_text(
        (scene / 'targets.yaml').read_text().replace('id: 3', 'id: 1'))
    (tmp_path / 'config.yaml').write_text('background_contrast: 0.0\n')
    assert main(['track-environment', str(scene / 'video'), '--map', str(scene / 'map.png'),
                 '--init', str(tmp_path / 'one.yaml'), '--out', str(tmp_path), '--seed', '4',
                 '--config', str(tmp_path / 'config.yaml')]) == 0
    wanted = {int(r['frame']): r for r in csv.DictReader((tmp_path / 'targets.csv').open())}
    told = []
    camera.create_subscription(DiagnosticArray, '/diagnostics', told.append, 10)
    marks = camera.create_publisher(PolygonStamped, '/mark', RELIABLE)
    x, y, w, h = BOX
    mark = PolygonStamped()
    mark.polygon.points = [Point32(x=float(x + 3), y=float(y)),
                           Point32(x=float(x + 3 + w), y=float(y + h))]
    with Process('environment_node', *parameters(
            scene, targets='""', background_contrast='0.0',
            **{'diagnostic_updater.period': '0.1'})):
        camera.wait(lambda: camera.ready() and marks.get_subscription_count(), STARTUP_S)
        settle(camera)
        for number, image in enumerate(frames(), 1):
            camera.images.publish(image_message(image, ns=number * PERIOD_NS,
                                                frame_id='camera_optical'))
            camera.wait(lambda: len(of_video(camera.tracks)) == number, EVENT_S)
            if number == 4:
                for ns in (3 * PERIOD_NS // 2, 2 * PERIOD_NS):
                    mark.header.stamp = to_stamp(ns)
                    marks.publish(mark)
                camera.wait(lambda: values_of(told).get('marked') == '1', EVENT_S)
    assert values_of(told)['marks_missed'] == '1' and values_of(told)['refused'] == '1'
    for number, message in enumerate(of_video(camera.tracks), 1):
        rows = np.frombuffer(bytes(message.data), RECORD)
        assert list(rows['id']) == ([1] if number > 4 else [])
        for row in rows:
            for name, column in (('left', 'x'), ('top', 'y'), ('width', 'w'), ('height', 'h')):
                assert row[name] == pytest.approx(float(wanted[number][column]), abs=2e-3)


def marked(*points):
    """Return the message that marks some points."""
    msg = PolygonStamped()
    msg.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in points]
    return msg


def test_marks_are_boxes_upright_or_rotated():
    upright = target_from_message(marked((42, 10), (30, 40)), 5, 7)
    assert (upright.id, upright.frame, upright.angle_rad) == (5, 7, 0.0)
    np.testing.assert_array_equal(upright.box_px, [30, 10, 12, 30])
    box, angle = np.array([30.0, 40.0, 20.0, 10.0]), 0.4
    rotated = target_from_message(marked(*corners(box, angle)), 1, 1)
    np.testing.assert_allclose(rotated.box_px, box, atol=1e-4)
    assert rotated.angle_rad == pytest.approx(angle, abs=1e-5)


@pytest.mark.parametrize('points', [
    [], [(1, 2)], [(1, 2), (1, 9)], [(1, 2), (float('nan'), 9)],
    [(0, 0), (20, 0), (25, 10), (5, 10)], [(0, 10), (20, 10), (20, 0), (0, 0)]],
    ids=['none', 'one', 'no width', 'nan', 'slanted', 'the wrong way round'])
def test_invalid_box_is_refused(points):
    with pytest.raises(InputError, match='mark: polygon: found'):
        target_from_message(marked(*points), 1, 1)


@pytest.mark.parametrize('dropped, stopped', [(7, []), (8, [3, 9])])
def test_target_is_dropped_in_a_gap_longer_than_an_occlusion_may_last(dropped, stopped):
    found = []
    node = SimpleNamespace(
        counter=SimpleNamespace(number=40), targets=[], config=SimpleNamespace(hidden_frames=8),
        tracker=SimpleNamespace(filters={3: None, 9: None}, stop=found.append))
    EnvironmentNode.on_gap(node, dropped)
    assert found == stopped


def test_mark_of_a_missing_frame_is_reported_for_a_while_and_counted():
    times = [100.0]
    tallies = {name: kind(clock=lambda: times[0]) for name, kind in (
        ('arrivals', Arrivals), ('marks_missed', Tally))}
    node = SimpleNamespace(
        **tallies, counter=SimpleNamespace(number=40, gaps=1, dropped=2, repeated=0, late=0),
        targets=[SimpleNamespace(id=4, frame=38)], config=SimpleNamespace(hidden_frames=8),
        tracker=SimpleNamespace(filters={}), ends=dict.fromkeys(TargetState, 0), resets=0,
        marked=0, refusals=Refusals(print),
        get_logger=lambda: SimpleNamespace(warning=print))
    EnvironmentNode.on_gap(node, 2)
    levels = []
    for times[0] in (101.0, 101.0 + WINDOW_S):
        node.arrivals.add()
        state = EnvironmentNode.state(node)
        levels.append(state.level)
        assert state.values['marks_missed'] == 1
    assert levels == [WARN, OK]


def test_dropped_repeated_and_missed_frames_are_reported(scene, camera):
    """Frames 1 to 3, 3 again, then 5 to 8; target 4 is marked in frame 4, which never arrives."""
    (scene / 'two.yaml').write_text(
        (scene / 'targets.yaml').read_text() + f'- {{id: 4, frame: 4, box: {list(BOX)}}}\n')
    told = []
    camera.create_subscription(DiagnosticArray, '/diagnostics', told.append, 10)

    images = dict(enumerate(frames(), 1))
    command = [sys.executable, '-m', 'stereo_speed.nodes.environment_node', '--ros-args']
    command += [w for p in parameters(scene, targets=scene / 'two.yaml') for w in ('-p', p)]
    node = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        camera.wait(camera.ready, STARTUP_S)
        settle(camera)
        for heard, number in enumerate((1, 2, 3, 5, 6, 7, 8), 1):
            for _ in range(1 + (number == 3)):
                camera.images.publish(image_message(images[number], ns=number * PERIOD_NS,
                                                    frame_id='camera_optical'))
            camera.wait(lambda: len(of_video(camera.tracks)) == heard, EVENT_S)
        camera.wait(lambda: values_of(told).get('frames') == '8'
                    and values_of(told)['resets'] == '1', EVENT_S)
        node.send_signal(signal.SIGINT)
        error = node.communicate(timeout=EVENT_S)[1]
    finally:
        node.kill()
    found = values_of(told)
    wanted = {'gaps': 1, 'dropped': 1, 'marks_missed': 1, 'repeated': 1, 'late': 0, 'resets': 1,
              'lost': 0, 'left_view': 0, 'followed': 1}
    assert {k: int(found[k]) for k in wanted} == wanted
    assert node.returncode == 0 and 'rosout' not in error and 'Traceback' not in error, error


@pytest.mark.parametrize('more, words', [
    ({'map': '""'}, ['map', 'nothing']),
    ({'map': 'none.png'}, ['none.png']),
    ({'tracker': 'kalman'}, ['tracker', 'kalman', 'environment']),
    ({'particles': 3}, ['particles']),
])
def test_bad_parameters_end_the_node_with_one_line(scene, more, words):
    command = [sys.executable, '-m', 'stereo_speed.nodes.environment_node', '--ros-args']
    command += [w for p in parameters(scene, **more) for w in ('-p', p)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=STARTUP_S)
    lines = [x for x in done.stderr.splitlines() if x.strip()]
    assert done.returncode == 2, done.stderr
    assert len(lines) == 1 and lines[0].startswith('error: '), done.stderr
    assert all(w in lines[0] for w in words), lines[0]
