# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs in shared memory are contiguous, and are restored unchanged."""
from __future__ import annotations

from mmap import mmap

import numpy as np
import pytest
from stereo_speed.core.records import RigMotion, StereoPair
from stereo_speed.core.shared_pair import SharedPair


@pytest.mark.parametrize('dtype', [np.uint8, np.uint16])
def test_successive_pairs_are_returned_unchanged(dtype):
    rng, shape, memory = np.random.default_rng(0), (3, 5), mmap(-1, 4096)
    pairs = [StereoPair(k, 10 * k, 10 * k + 1, rng.integers(0, 255, shape).astype(dtype),
                        rng.integers(0, 255, shape).astype(dtype),
                        motion=RigMotion((1e-4 * k, 0.0, 0.0)), blur_px2=0.5 * k)
             for k in range(3)]
    shared, begin = [], 0
    for pair in pairs:
        shared.append(SharedPair.of(pair, begin))
        shared[-1].lay(pair, memory)
        begin = shared[-1].end
    assert begin == 3 * 2 * 15 * np.dtype(dtype).itemsize
    for there, pair in zip(shared, pairs):
        back = there.pair(memory)
        assert (back.index, back.stamp_ns, back.right_stamp_ns, back.motion, back.blur_px2) == (
            pair.index, pair.stamp_ns, pair.right_stamp_ns, pair.motion, pair.blur_px2)
        assert back.left.dtype == dtype
        assert np.array_equal(back.left, pair.left) and np.array_equal(back.right, pair.right)
