# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Messages of a measuring node, captured in this process."""
from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy')

from rclpy.clock import Clock  # noqa: E402, I100
from stereo_speed.enforcement.instrument import Instrument  # noqa: E402
from stereo_speed.io.bags import StereoBag  # noqa: E402
from stereo_speed.nodes.outputs import Outputs  # noqa: E402
from stereo_speed.pipeline.assembly import MeasuringSite  # noqa: E402
from stereo_speed.pipeline.config import PipelineConfig  # noqa: E402
from stereo_speed.site.file import load_site  # noqa: E402
from visualization_msgs.msg import Marker  # noqa: E402

PASSED = {'passed_utc': '2026-11-22T10:00:00Z', 'off_percent': 0.23}
LATER = {**PASSED, 'passed_utc': '2026-11-22T11:00:00Z'}


@pytest.fixture()
def told():
    """Return the published messages by topic."""
    return defaultdict(list)


@pytest.fixture()
def outputs(told):
    """Return the outputs of a stand-in node."""
    node = SimpleNamespace(
        create_publisher=lambda kind, topic, *_, **__: SimpleNamespace(
            publish=told[topic].append, get_subscription_count=lambda: topic == 'markers'),
        get_logger=lambda: SimpleNamespace(info=lambda line: None), get_clock=Clock)
    return Outputs(node, SimpleNamespace(get=lambda name, default, *_: default))


@pytest.fixture()
def place(sample):
    with StereoBag(sample / 'bag') as bag:
        return MeasuringSite.of(load_site(sample / 'site.yaml'), bag.rig)


def test_instrument_is_published_with_each_self_test_and_calibration(told, outputs, place):
    pipeline = place.pipeline(PipelineConfig())
    outputs.tell_self_test(None)
    outputs.begin(pipeline, place, PipelineConfig())
    assert not told['instrument'] and not outputs.static_is_overdue  # readings come first
    outputs.publish_static()
    for newest in (None, PASSED, PASSED, LATER):
        outputs.tell_self_test(newest)
    outputs.begin(pipeline, place, PipelineConfig())  # with another calibration, say
    outputs.publish_static()
    outputs.publish_static()  # publishes nothing the second time

    found = [Instrument.of_text(message.data, 'instrument') for message in told['instrument']]
    assert [one.self_test for one in found] == [None, PASSED, LATER, LATER]
    assert {replace(one, self_test=None).text() for one in found} == {found[0].text()}
    assert len(told['lane_markers']) == 2  # the lanes stand as they did


def test_self_test_passed_before_the_rig_is_known_is_published_with_it(told, outputs, place):
    outputs.tell_self_test(PASSED)
    assert not told['instrument']
    outputs.begin(place.pipeline(PipelineConfig()), place, PipelineConfig())
    outputs.publish_static()
    message, = told['instrument']
    assert Instrument.of_text(message.data, 'instrument').self_test == PASSED


@pytest.mark.slow
def test_markers_of_a_vehicle_are_deleted_with_its_pass(told, outputs, place, sample):
    pipeline = place.pipeline(PipelineConfig())
    with StereoBag(sample / 'bag') as bag:
        for pair in bag.pairs():
            outputs.tell(pipeline, pair, pipeline.process(pair))
    shown = {(m.ns, m.id) for message in told['markers'] for m in message.markers
             if m.action == Marker.ADD}
    assert shown == {('vehicles', 0), ('speed_text', 0)}
    before = len(told['markers'])
    outputs.end(pipeline, pipeline.finish())
    assert len(told['passes']) == 1
    message, = told['markers'][before:]
    assert {(m.ns, m.id, m.action) for m in message.markers} == {
        (ns, track, Marker.DELETE) for ns, track in shown}
    assert {m.header.frame_id for m in message.markers} == {pipeline.rig.frame_id}
    outputs.end(pipeline, [])
    assert len(told['markers']) == before + 1  # nothing is deleted without a pass
