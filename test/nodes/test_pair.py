# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The pair's message restores its images, and displays as a plain image."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.io.images import grey_from_message
from stereo_speed.nodes.common import image_message
from stereo_speed.nodes.pair import pair_from_message, pair_message


@pytest.mark.parametrize('kind', [np.uint8, np.uint16])
def test_pair_and_both_stamps_come_back(kind):
    rng = np.random.default_rng(0)
    left, right = rng.integers(0, np.iinfo(kind).max, (2, 5, 7)).astype(kind)
    left_ns, right_ns = 1_700_000_000_123_456_789, 1_700_000_000_123_956_780
    msg = pair_message(left, right, left_ns=left_ns, right_ns=right_ns, frame_id='left_optical')
    pair = pair_from_message(msg, 4)
    assert (pair.index, pair.stamp_ns, pair.right_stamp_ns) == (4, left_ns, right_ns)
    np.testing.assert_array_equal(pair.left, left)
    np.testing.assert_array_equal(pair.right, right)
    # Viewers show one image, the left above the right.
    np.testing.assert_array_equal(grey_from_message(msg, ''), np.vstack([left, right]))


def test_image_that_is_no_pair_is_refused():
    msg = image_message(np.zeros((8, 6), np.uint8), ns=1, frame_id='left')
    with pytest.raises(InputError, match='right stamp'):
        pair_from_message(msg, 0)


def test_images_of_two_sizes_make_no_pair():
    with pytest.raises(InputError, match='as the left image'):
        pair_message(np.zeros((4, 6), np.uint8), np.zeros((4, 5), np.uint8), left_ns=1,
                     right_ns=1, frame_id='left')
