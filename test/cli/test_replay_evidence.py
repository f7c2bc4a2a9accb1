# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A replay that reads ahead records the same images for each pass as one that does not."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.cli.replay_evidence import ReplayEvidence
from stereo_speed.core.records import StereoPair
from stereo_speed.enforcement.config import EnforcementConfig
from stereo_speed.enforcement.ring import ImageRing
from stereo_speed.io.source_image import SourceImage
from stereo_speed.pipeline.pipeline import Step

PAIRS = 12
HELD = 3  # pairs that the ring has room for
END = 5  # pair that ends a pass
STEP_NS = 100


class Recorder:
    """Records for each offered pass the pairs of which both images are buffered."""

    def __init__(self):
        self.ring = ImageRing(2 * HELD * len(image().data), 10 ** 12)
        self.offered = []

    def offer(self, record_id, result):
        """Record the buffered pairs."""
        self.offered.append((result.track, [
            k for k in range(PAIRS) if self.ring.get('left', k * STEP_NS)
            and self.ring.get('right', k * STEP_NS + 1)]))

    def delete_older(self, now_ns):
        """Delete nothing."""


def image():
    return SourceImage('mono8', bytes(4), 4, 1, 4)


@pytest.mark.parametrize('read_ahead', [1, 4, PAIRS])
def test_reading_ahead_drops_no_image_before_its_pass_is_published(read_ahead):
    recorder = Recorder()
    evidence, blank = ReplayEvidence(recorder, 'run', EnforcementConfig()), np.zeros((1, 4), 'u1')
    pairs = [StereoPair(k, k * STEP_NS, k * STEP_NS + 1, blank, blank) for k in range(PAIRS)]
    for k, pair in enumerate(pairs):
        evidence.take(pair, image(), image())
        told = k + 1 - read_ahead
        if told >= 0:
            evidence.observe(pairs[told], step(told))
    for told in range(PAIRS - read_ahead + 1, PAIRS):
        evidence.observe(pairs[told], step(told))
    evidence.finish([SimpleNamespace(track=END), SimpleNamespace(track=99)])
    assert recorder.offered == [
        (END, [END - 2, END - 1, END]), (99, [PAIRS - 3, PAIRS - 2, PAIRS - 1])]


def step(index):
    return Step([], [SimpleNamespace(track=END)] if index == END else [])
