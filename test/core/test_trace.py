# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Which pairs of a pass show its vehicle where it was measured."""
from __future__ import annotations

import numpy as np
from stereo_speed.core.records import InitialFront, TrackState, TrackUpdate
from stereo_speed.core.trace import PassTrace, TracePair

BOX = np.array([[0.0, 0], [10, 0], [10, 8], [0, 8]])


def test_what_is_shown_is_confirmed_and_measured_from():
    states = [TrackState.TENTATIVE, TrackState.TENTATIVE, TrackState.CONFIRMED,
              TrackState.COASTING, TrackState.CONFIRMED, TrackState.CONFIRMED, None]
    pairs = tuple(TracePair(k, k, None, None, None if state is None else TrackUpdate(
        k, 0, 'near', state, 20.0, 0.1, 5.0, 0.0, np.zeros(3), np.eye(3), np.eye(3), BOX, BOX))
        for k, state in enumerate(states))
    trace = PassTrace(0, 0, 'near', InitialFront(0, BOX, BOX), 400, None, pairs)
    assert [pair.stamp_ns for pair in trace.shown({1, 2, 3, 4, 6})] == [2, 4]
    assert trace.shown(set()) == ()
