# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What the overlay shows, and that no reading waits for it."""
from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
import threading
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

pytest.importorskip('rclpy')

from stereo_speed.io.bags import StereoBag  # noqa: E402, I100
from stereo_speed.nodes.common import stamp_ns  # noqa: E402
from stereo_speed.nodes.overlay import Overlay  # noqa: E402
from stereo_speed.pipeline.assembly import MeasuringSite  # noqa: E402
from stereo_speed.pipeline.config import PipelineConfig  # noqa: E402
from stereo_speed.report.overlay import draw  # noqa: E402
from stereo_speed.site.file import load_site  # noqa: E402

LEFT, RIGHT, JPEG = (f'overlay/{topic}' for topic in (
    'image_raw', 'right/image_raw', 'image_raw/compressed'))
WAIT_S = 20.0


@dataclass(frozen=True)
class Pair:
    """A stand-in for a pair."""

    stamp_ns: int = 0
    right_stamp_ns: int = 0


class Graph:
    """A stand-in for a node, and for the subscribers of its topics."""

    def __init__(self, *subscribed):
        self.subscribed, self.told, self.errors = subscribed, defaultdict(list), []

    def create_publisher(self, kind, topic, *_, **__):
        return SimpleNamespace(publish=self.told[topic].append,
                               get_subscription_count=lambda: topic in self.subscribed)

    def get_logger(self):
        return SimpleNamespace(error=lambda line, **_: self.errors.append(line))

    def stamps(self, topic):
        """Return the stamps of the images of a topic."""
        return [stamp_ns(msg.header.stamp) for msg in self.told[topic]]


def overlay_of(graph, **given):
    """Return an overlay with default parameters."""
    return Overlay(graph, SimpleNamespace(get=lambda name, default, *_: default), 'right_frame',
                   **given)


PIPELINE = SimpleNamespace(lanes={}, rig=SimpleNamespace(frame_id='left_frame'))


@pytest.fixture(scope='module')
def measured(sample):
    """Return a pipeline, the fourth pair of the sample, and the updates of its track."""
    with StereoBag(sample / 'bag') as bag:
        place = MeasuringSite.of(load_site(sample / 'site.yaml'), bag.rig)
        pipeline = place.pipeline(PipelineConfig())
        for _, pair in zip(range(4), bag.pairs()):
            updates = pipeline.process(pair).updates
    assert updates
    return pipeline, pair, updates


def test_topics_show_the_drawn_views_with_their_stamps_and_frames(measured):
    pipeline, pair, updates = measured
    graph = Graph(LEFT, RIGHT, JPEG)
    overlay = overlay_of(graph)
    overlay.show(pipeline, pair, updates)
    overlay.close()
    left, right = (draw(pair, updates, pipeline.lanes, pipeline.rig, right=side)
                   for side in (False, True))
    for topic, image, ns, frame in ((LEFT, left, pair.stamp_ns, pipeline.rig.frame_id),
                                    (RIGHT, right, pair.right_stamp_ns, 'right_frame')):
        msg, = graph.told[topic]
        assert (msg.encoding, stamp_ns(msg.header.stamp), msg.header.frame_id) == (
            'bgr8', ns, frame)
        assert np.array_equal(np.frombuffer(msg.data, np.uint8), image.ravel())
    msg, = graph.told[JPEG]
    assert msg.format == 'bgr8; jpeg compressed bgr8'
    assert (stamp_ns(msg.header.stamp), msg.header.frame_id) == (
        pair.stamp_ns, pipeline.rig.frame_id)
    decoded = cv2.imdecode(np.frombuffer(msg.data, np.uint8), cv2.IMREAD_COLOR)
    assert decoded.shape == left.shape == (*pair.left.shape, 3)
    # Quality 80 keeps grey levels to a few of 255; another picture would differ by dozens.
    assert np.abs(decoded.astype(float) - left).mean() < 5.0


def test_pairs_that_come_during_a_drawing_do_not_wait_for_it():
    graph, drawing, go_on = Graph(LEFT), threading.Event(), threading.Event()

    def slow(*_, **__):
        drawing.set()
        assert go_on.wait(WAIT_S)
        return np.zeros((4, 6, 3), np.uint8)
    times = iter(range(10))
    overlay = overlay_of(graph, draw=slow, clock=lambda: next(times))
    overlay.show(PIPELINE, Pair(1), [])
    assert drawing.wait(WAIT_S)
    for ns in (2, 3):
        overlay.show(PIPELINE, Pair(ns), [])  # would not return if it waited
    assert graph.stamps(LEFT) == []
    go_on.set()
    overlay.close()
    assert graph.stamps(LEFT) == [1]


def test_overlay_is_drawn_at_a_limited_rate_and_for_subscribers_only():
    graph, now_s = Graph(), [100.0]
    overlay = overlay_of(graph, draw=lambda *_, **__: np.zeros((4, 6, 3), np.uint8),
                         clock=lambda: now_s[0])

    def show(ns, seconds):
        now_s[0] += seconds
        overlay.show(PIPELINE, Pair(ns), [])
        overlay._thread.submit(lambda: None).result(WAIT_S)  # all before it is drawn
    show(1, 0.0)
    graph.subscribed = (LEFT,)
    for ns, seconds in ((2, 0.0), (3, 0.09), (4, 0.02), (5, 0.05), (6, 0.06)):
        show(ns, seconds)
    overlay.close()
    assert {topic: graph.stamps(topic) for topic in (LEFT, RIGHT, JPEG)} == {
        LEFT: [2, 4, 6], RIGHT: [], JPEG: []}


def test_failed_drawing_is_logged_and_the_next_pair_is_drawn():
    graph, images = Graph(LEFT), iter([None, np.zeros((4, 6, 3), np.uint8)])
    times = iter(range(10))
    overlay = overlay_of(graph, draw=lambda *_, **__: next(images), clock=lambda: next(times))
    for ns in (1, 2):
        overlay.show(PIPELINE, Pair(ns), [])
        overlay._thread.submit(lambda: None).result(WAIT_S)
    overlay.close()
    assert graph.stamps(LEFT) == [2]
    assert len(graph.errors) == 1 and graph.errors[0].startswith('overlay: ')
