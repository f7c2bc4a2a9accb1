# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Which keyframes of a pass become inactive, and which are forgotten."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from stereo_speed.tracking.keyframes import Keyframe, least_gap, Window


def window_at(*stamps_ns):
    """Return a window of keyframes that have only stamps, each with its stamp as its states."""
    keyframes = tuple(Keyframe(SimpleNamespace(stamp_ns=ns), None) for ns in stamps_ns)
    states = np.repeat(np.array(stamps_ns, float)[:, None], 4, axis=1)
    return Window(keyframes, states, np.zeros(1), np.ones(1))


def test_pair_whose_removal_leaves_the_least_gap_goes():
    assert least_gap(window_at(0, 100, 130, 160, 300).pairs) == 2
    assert least_gap(window_at(0, 100).pairs) == 1  # of two, the newer


def test_no_more_pairs_than_allowed_wait_for_the_end_of_the_pass():
    window = window_at(0, 10, 20, 30, 40, 50)
    for _ in range(3):
        window = window.deactivated(1, most=2)
    assert [pair.stamp_ns for pair in window.inactive] == [10, 30]
    assert window.states[:, 0].tolist() == [0, 40, 50]


def test_occluded_pairs_do_not_count_unless_none_did():
    window = window_at(0, 10, 20, 30)
    judged = window.judged(np.array([False, True, True, False]))
    assert judged.counts().tolist() == [False, True, True, False]
    assert judged.unshown(fewest=3) == 1 and judged.unshown(fewest=4) == 0
    assert judged.judged(np.zeros(4, bool)) is judged
    assert judged.since(1).counts().tolist() == [True, True, False]
