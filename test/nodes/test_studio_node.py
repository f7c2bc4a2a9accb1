# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The live page, as a real process that listens to real messages."""
from __future__ import annotations

import http.cookiejar
import json
from pathlib import Path
import re
import signal
import subprocess
import sys
import urllib.request

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402, I100
from geometry_msgs.msg import TwistWithCovarianceStamped  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from stereo_speed.nodes.common import image_message, RELIABLE  # noqa: E402
import yaml  # noqa: E402

START_S, EVENT_S = 60.0, 30.0


def test_messages_of_the_graph_are_on_the_page(stand_in):
    latched = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    speeds, images, right, passes, health = (stand_in.create_publisher(*what) for what in (
        (TwistWithCovarianceStamped, 'vehicle_speed', RELIABLE),
        (Image, 'overlay/image_raw', RELIABLE),
        (Image, 'overlay/right/image_raw', RELIABLE), (String, 'passes', latched),
        (DiagnosticArray, '/diagnostics', 10)))
    passes.publish(String(data='not a pass'))
    passes.publish(String(data=json.dumps({  # published before any page was opened
        'track': 4, 'lane': 'near', 'speed_mps': 20.0, 'speed_std_mps': 0.1,
        'verdict': 'measured', 'reason': ''})))
    command = [sys.executable, '-m', 'stereo_speed', 'studio', '--live', '--port', '0']
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            url = process.stdout.readline().split()[-1]
            page = urllib.request.build_opener(
                urllib.request.HTTPCookieProcessor(http.cookiejar.CookieJar()))
            page.open(url, timeout=START_S).close()
            base = url.partition('?')[0]

            def live():
                with page.open(f'{base}api/live', timeout=START_S) as answer:
                    return json.load(answer)
            stand_in.wait(lambda: all(p.get_subscription_count() for p in (
                speeds, images, right, passes, health)), START_S)
            speed = TwistWithCovarianceStamped()
            speed.header.frame_id, speed.twist.twist.linear.x = 'vehicle_7', 24.5
            speed.twist.covariance[0] = 0.04
            speeds.publish(speed)
            for publisher in (images, right):
                for no_image in (Image(), Image(encoding='bgr8', height=2, width=2, step=6),
                                 Image(encoding='jpeg', height=1, width=1, step=1, data=[1])):
                    publisher.publish(no_image)
                publisher.publish(image_message(np.zeros((48, 64, 3), np.uint8), ns=5,
                                                frame_id='left'))
            health.publish(DiagnosticArray(status=[DiagnosticStatus(
                level=b'\x01', name='tracker_node: pipeline', message='late')]))
            stand_in.wait(lambda: live()['readings'] and live()['passes'] and live()['health']
                          and len(live()['views']) == 2, EVENT_S)
            now = live()
            reading, = now['readings']
            assert reading.pop('age_s') < EVENT_S
            assert reading == {'track': 'vehicle_7', 'stamp_ns': 0, 'speed_mps': 24.5,
                               'std_mps': pytest.approx(0.2)}
            assert [p['track'] for p in now['passes']] == [4]
            assert (now['health'][0]['level'], now['health'][0]['message']) == (1, 'late')
            for view in ('left', 'right'):
                with page.open(f'{base}api/live/overlay/{view}', timeout=START_S) as answer:
                    assert answer.read()[:2] == b'\xff\xd8'
        finally:
            process.send_signal(signal.SIGINT)
            try:
                assert process.wait(timeout=START_S) == 0
            finally:
                process.kill()


@pytest.mark.parametrize('name', ['stereo_speed.rviz', 'stereo_speed.foxglove.json'])
def test_layouts_name_existing_topics(name):
    root = Path(__file__).resolve().parents[2]
    text = (root / 'config' / name).read_text()
    yaml.safe_load(text)  # JSON is YAML as well
    named = {topic.partition('.')[0] for topic in re.findall(r'"?(?<=[": ])/([a-z_/]+)', text)}
    code = ' '.join(path.read_text() for path in (root / 'stereo_speed/nodes').glob('*.py'))
    assert named and {t for t in named if f"'{t}'" not in code and f"'/{t}'" not in code} == set()
