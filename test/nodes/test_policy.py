# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The security policy allows exactly what the nodes use in the graph."""
from __future__ import annotations

from importlib import import_module
from pathlib import Path
import time
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

pytest.importorskip('rclpy')

from stereo_speed.nodes import frames  # noqa: E402, I100

ROOT = Path(__file__).resolve().parents[2]
SETTLE_S = 20.0
SIM_TIME = 'use_sim_time:=true'  # then /clock is subscribed to
COMPRESSED = 'image_transport:=compressed'
SITE = 'site:={sample}/site.yaml'
# Parameters of each node, once for each choice that changes its topics or services.
NODES = {
    'stereo_sync_node': ('StereoSyncNode', [[SIM_TIME], [COMPRESSED]]),
    'tracker_node': ('TrackerNode', [[SIM_TIME, SITE, 'detector:=boxes']]),
    'speed_node': ('SpeedNode', [[SIM_TIME]]),
    'speed_camera_node': ('SpeedCameraNode', [[SIM_TIME, SITE, 'detector:=boxes'],
                                              [SITE, COMPRESSED]]),
    'evidence_node': ('EvidenceNode', [[SIM_TIME, 'out:={tmp}/raw'],
                                       ['out:={tmp}/jpg', COMPRESSED]]),
    'log_node': ('LogNode', [[SIM_TIME, 'file:={tmp}/log.sqlite']]),
    'studio_node': ('StudioNode', [[SIM_TIME, 'port:=0']]),
    'environment_node': ('EnvironmentNode', [
        [SIM_TIME, 'map:={tmp}/map.png', 'targets:={tmp}/targets.yaml'],
        ['map:={tmp}/map.png', 'targets:={tmp}/targets.yaml', COMPRESSED]]),
    'replay_node': ('ReplayNode', [['bag:={sample}/bag'], ['bag:={sample}/bag', 'decode:=false']]),
}

MODULES = {'tracker_node': 'tracker', 'speed_camera_node': 'speed_camera'}  # others: the name


@pytest.fixture(scope='module')
def profiles():
    """Return the profiles of the policy by node."""
    policy = ElementTree.parse(ROOT / 'config' / 'stereo_speed.policy.xml').getroot()
    return {profile.get('node'): profile for profile in policy.iter('profile')}


def allowed(profile, what, kind):
    """Return the names of topics or services that a profile allows, in the root namespace."""
    return {f'/{name.text.lstrip("/")}' for group in profile.iter(what)
            if group.get(kind) == 'ALLOW' for name in group}


def found(node):
    """Activate a node with a lifecycle, and return its topics and services in the graph."""
    getattr(node, 'begin', lambda: None)()
    of, end_s = (node.get_name(), node.get_namespace()), time.monotonic() + SETTLE_S
    made = [{one.topic_name for one in node.publishers},
            {one.topic_name for one in node.subscriptions}, set()]
    while True:  # the graph may show new entities a moment later
        has = [{topic for topic, _ in ask(*of)} for ask in (
            node.get_publisher_names_and_types_by_node,
            node.get_subscriber_names_and_types_by_node,
            node.get_service_names_and_types_by_node)]
        if all(own <= all_of for own, all_of in zip(made, has)) or time.monotonic() > end_s:
            return has
        time.sleep(0.02)


@pytest.mark.parametrize('name', NODES)
def test_profile_allows_what_the_node_has(in_process, name, profiles, sample, tmp_path):
    cv2.imwrite(str(tmp_path / 'map.png'), np.full((120, 160), 255, np.uint8))
    (tmp_path / 'targets.yaml').write_text(
        'environment_targets: 1\ntargets:\n- {id: 3, frame: 2, box: [30, 40, 12, 30]}\n')
    kind, choices = NODES[name]
    names = [set(), set(), set()]
    make = getattr(import_module(f'stereo_speed.nodes.{MODULES.get(name, name)}'), kind)
    for choice in choices:
        with in_process(make, *(p.format(sample=sample, tmp=tmp_path) for p in choice)) as node:
            for all_of, some in zip(names, found(node)):
                all_of |= some
    if frames.TFMessage is None and kind in ('TrackerNode', 'SpeedCameraNode'):
        names[0].add('/tf_static')  # published wherever tf2_msgs is installed
    profile = profiles[name]
    for has, what, verb in zip(names, ('topics', 'topics', 'services'),
                               ('publish', 'subscribe', 'reply')):
        assert allowed(profile, what, verb) == has, verb


def test_every_node_was_tried(profiles):
    assert set(profiles) == set(NODES)


def test_layouts_show_published_topics(profiles):
    """Also the lanes, which are published once."""
    published = set().union(*(allowed(p, 'topics', 'publish') for p in profiles.values()))
    for layout in ('stereo_speed.rviz', 'stereo_speed.foxglove.json'):
        text = (ROOT / 'config' / layout).read_text()
        for topic in ('/markers', '/lane_markers', '/overlay/image_raw'):
            assert topic in text and topic in published
