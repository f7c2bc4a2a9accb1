# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The pairs of a trace that show the vehicle, and the content of a trace."""
from __future__ import annotations

import numpy as np
from stereo_speed.core.records import InitialFront, StereoPair, TrackState, TrackUpdate
from stereo_speed.core.trace import PassTrace, TraceBuilder, TracePair

BOX = np.array([[0.0, 0], [10, 0], [10, 8], [0, 8]])


def said(ns, track=0, off_px=0.0, state=TrackState.CONFIRMED):
    """Return a track's update for a pair."""
    return TrackUpdate(ns, track, 'near', state, 20.0, 0.1, 5.0, 0.0, np.zeros(3), np.eye(3),
                       np.eye(3), BOX + off_px, BOX)


def test_shown_pairs_are_confirmed_and_measured_from():
    states = [TrackState.TENTATIVE, TrackState.TENTATIVE, TrackState.CONFIRMED,
              TrackState.COASTING, TrackState.CONFIRMED, TrackState.CONFIRMED, None]
    pairs = tuple(TracePair(k, k, None, None, None if state is None else said(k, state=state))
                  for k, state in enumerate(states))
    trace = PassTrace(0, 0, 'near', InitialFront(0, BOX, BOX), 400, None, pairs)
    assert [pair.stamp_ns for pair in trace.shown({1, 2, 3, 4, 6})] == [2, 4]
    assert trace.shown(set()) == ()


def test_last_update_of_each_other_vehicle_in_a_pair_counts():
    builder, image = TraceBuilder(
        PassTrace(0, 0, 'near', InitialFront(0, BOX, BOX), 400, None, ())), np.zeros((2, 2))
    for ns in (1, 2):
        builder.add(StereoPair(ns, ns, ns, image, image), 400, said(ns), stamp_std_s=1e-3)
    builder.add_others(1, [said(1), said(1, 1), said(1, 2)])
    builder.add_others(1, [said(1, 1, off_px=3.0)])
    builder.add_others(3, [said(3, 1)])  # which the tracker was not given
    first, second = builder.built().pairs
    assert [(other.track, other.left_px[0, 0]) for other in first.others] == [(1, 3.0), (2, 0.0)]
    assert second.others == ()


def test_stamp_uncertainty_may_rise_after_the_last_pair():
    builder, image = TraceBuilder(
        PassTrace(0, 0, 'near', InitialFront(0, BOX, BOX), 400, None, ())), np.zeros((2, 2))
    for ns in (1, 2):
        builder.add(StereoPair(ns, ns, ns, image, image), 400, said(ns), stamp_std_s=1e-3)
    assert [pair.stamp_std_s for pair in builder.built(3e-3).pairs] == [1e-3, 3e-3]
    assert [pair.stamp_std_s for pair in builder.built().pairs] == [1e-3, 1e-3]
