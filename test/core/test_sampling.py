# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Evenly spaced items of streams."""
from __future__ import annotations

import pytest
from stereo_speed.core.sampling import EvenSampler


@pytest.mark.parametrize(('count', 'length', 'wanted'), [
    (3, 2, [0, 1]), (3, 6, [0, 2, 5]), (1, 4, [0]), (4, 0, []),
], ids=['fewer', 'even', 'one', 'none'])
def test_sampler_by_hand(count, length, wanted):
    assert sampled(count, length) == wanted


def test_sampler_keeps_few_items_and_spans_the_stream():
    sampler = EvenSampler(9)
    for item in range(10_000):
        if sampler.wants():
            sampler.add(item)
        assert len(sampler.kept) <= 18
    frames = sampler.items()
    assert len(frames) == 9
    assert frames[0] == 0
    assert frames[-1] > 8000


def sampled(count: int, length: int) -> list[int]:
    """Feed the numbers below ``length`` to a sampler."""
    sampler = EvenSampler(count)
    for item in range(length):
        if sampler.wants():
            sampler.add(item)
    return sampler.items()
