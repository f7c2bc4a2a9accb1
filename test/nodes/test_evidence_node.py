# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``evidence_node`` in this process: a disk that fills up, images that come late."""
from __future__ import annotations

from collections import namedtuple
import json
import shutil
import time

import pytest

rclpy = pytest.importorskip('rclpy')

from std_msgs.msg import String  # noqa: E402, I100
from stereo_speed.enforcement.decision import NoRecord  # noqa: E402
from stereo_speed.enforcement.instrument import Instrument  # noqa: E402
from stereo_speed.enforcement.verify import verify  # noqa: E402
from stereo_speed.io.bags import StereoBag  # noqa: E402
from stereo_speed.io.pass_json import pass_text  # noqa: E402
from stereo_speed.io.trace_json import trace_text  # noqa: E402
from stereo_speed.nodes import evidence_node  # noqa: E402
from stereo_speed.nodes.evidence_node import EvidenceNode  # noqa: E402
from stereo_speed.nodes.health import ERROR  # noqa: E402
from stereo_speed.pipeline.assembly import MeasuringSite  # noqa: E402
from stereo_speed.pipeline.config import PipelineConfig  # noqa: E402
from stereo_speed.pipeline.run import run  # noqa: E402
from stereo_speed.site.file import load_site  # noqa: E402

LONGEST_S = 180.0
PASSED = {'passed_utc': '2026-11-22T10:00:00Z', 'off_percent': 0.23}

pytestmark = pytest.mark.usefixtures('private_graph')


@pytest.fixture()
def node(tmp_path, in_process):
    with in_process(EvidenceNode, f'out:={tmp_path / "evidence"}') as node:
        yield node


def wait(node, condition):
    """Let the node report its writer's progress until the condition holds."""
    end_s = time.monotonic() + LONGEST_S
    while not condition() and time.monotonic() < end_s:
        node.tell()
        time.sleep(0.02)
    assert condition()


@pytest.fixture()
def told(sample):
    """Return the instrument message of a program that measures the sample."""
    with StereoBag(sample / 'bag') as bag:
        place = MeasuringSite.of(load_site(sample / 'site.yaml'), bag.rig)
    return json.loads(Instrument.of('run', place, PipelineConfig()).text())


def test_lanes_are_fitted_again_only_if_more_than_the_self_test_changed(node, told):
    places = []
    for change in ({}, {'self_test': PASSED}, {'site_name': 'another'}):
        told.update(change)
        node.on_instrument(String(data=json.dumps(told)))
        setting = node.recorders['run'].setting
        assert json.loads(setting.instrument.text()) == told
        places.append(setting.place)
    assert places[0] is places[1] and places[1] is not places[2]
    assert places[2].site.name == 'another'


@pytest.fixture(scope='module')
def violation(sample):
    """Return the site of the sample, its one pass, and the images by side and stamp."""
    images = []
    with StereoBag(sample / 'bag') as bag:
        place = MeasuringSite.of(load_site(sample / 'site.yaml'), bag.rig)
        bag.watcher = lambda pair, left, right: images.extend([
            ('left', pair.stamp_ns, left), ('right', pair.right_stamp_ns, right)])
        result, = run(place.pipeline(PipelineConfig()), bag.pairs()).passes
    return place, result, images


def tell_pass(node, place, result):
    """Send what a measuring node sends of a pass, without its images."""
    node.on_instrument(String(data=Instrument.of('run', place, PipelineConfig()).text()))
    node.on_trace(String(data=trace_text('run', result)))
    node.on_pass(String(data=pass_text('run', result)))


@pytest.mark.slow
def test_images_that_come_after_their_pass_are_waited_for(node, violation, monkeypatch):
    """On a busy machine, images may be taken from their queue after the message of the pass."""
    place, result, images = violation
    monkeypatch.setattr(evidence_node, '_IMAGES_S', LONGEST_S)
    for image in images[:-3]:
        node.ring.add(*image)
    tell_pass(node, place, result)
    node.tell()
    assert not node.counts['passes']
    for image in images[-3:]:
        node.ring.add(*image)
    wait(node, lambda: len(node.store.chain) == 1)
    assert node.counts['passes'] == 1


@pytest.mark.slow
@pytest.mark.parametrize('lost, looks', [(1, 0), (-1, 50)])
def test_a_pass_with_a_lost_image_has_no_record(node, violation, lost, looks):
    """An image that is lost on its way is not waited for once a later one has come."""
    place, result, images = violation
    for n, image in enumerate(images):
        if n != lost % len(images):
            node.ring.add(*image)
    tell_pass(node, place, result)
    for _ in range(looks):
        assert not node.counts['passes']
        node.tell()
    assert node.counts['passes'] == 1
    assert node.recorders['run'].refused == {NoRecord.IMAGES_MISSING: 1}


@pytest.mark.slow
def test_full_disk_is_an_error_until_a_record_is_written_again(
        node, violation, tmp_path, monkeypatch):
    """A pass that is sent again is the same; its record has the instrument's message."""
    place, result, images = violation
    for image in images:
        node.ring.add(*image)
    usage = namedtuple('usage', 'total used free')
    monkeypatch.setattr(shutil, 'disk_usage', lambda path: usage(1 << 40, 1 << 40, 99))
    instrument = json.loads(Instrument.of('run', place, PipelineConfig()).text())
    node.on_instrument(String(data=json.dumps({**instrument, 'self_test': PASSED})))

    def tell():
        node.on_trace(String(data=trace_text('run', result)))
        node.on_pass(String(data=pass_text('run', result)))
    tell()
    wait(node, lambda: node.wrong)
    state = node.state()
    assert state.level == ERROR and 'no records: ' in state.message
    assert 'free space' in state.message
    assert state.values['no_record_not_stored'] == 1 and state.values['records'] == 0

    monkeypatch.undo()
    tell()
    wait(node, lambda: len(node.store.chain) == 1 and not node.wrong)
    assert 'no records' not in node.state().message and node.state().values['records'] == 1
    path, = (tmp_path / 'evidence').glob('*/record.json')
    assert json.loads(path.read_text())['instrument']['self_test'] == PASSED
    assert verify(tmp_path / 'evidence').sound
