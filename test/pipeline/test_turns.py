# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Which vehicle is solved for when there is no time for all, worked by hand."""
from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.core.records import TrackState
from stereo_speed.pipeline.track import Track
from stereo_speed.pipeline.turns import take_turns
from stereo_speed.tracking.protocol import MOST_TIMES, OCCLUDED_TIMES, OLD_S

NOW_NS = 5_000_000_000
INTERVAL_S = 0.06


class Aging:
    """Stands in for a tracker with a given age of its last solution; records its calls."""

    def __init__(self, unsolved_s):
        self.age_s, self.told = unsolved_s, None

    def unsolved_s(self, stamp_ns):
        """Return the age of its last solution."""
        return self.age_s

    def hurry(self, hurried):
        """Record the call."""
        self.told = hurried


def tracks_of(*ages_s, occluded=()):
    return [Track(Aging(s), None, None, 0, None, None, None, last=SimpleNamespace(
        state=TrackState.COASTING if k in occluded else TrackState.CONFIRMED))
        for k, s in enumerate(ages_s)]


def told(tracks, *, hurried=False, dense=False):
    take_turns(tracks, NOW_NS, INTERVAL_S, hurried=hurried, dense=dense)
    assert [t.hurried for t in tracks] == [t.tracker.told for t in tracks]
    return [t.tracker.told for t in tracks]


def test_no_track_is_hurried_where_pairs_are_rare():
    assert told(tracks_of(1.0, 0.1, 0.01)) == [False] * 3


def test_dense_pair_solves_the_due_track_that_waited_longest():
    """A track that is not due does little by itself, and after two intervals none waits."""
    due = 1.1 * INTERVAL_S
    assert told(tracks_of(due, 1.2 * due, 0.5 * INTERVAL_S), dense=True) == [True, False, False]
    late = 1.1 * MOST_TIMES * INTERVAL_S
    assert told(tracks_of(late, 1.2 * late), dense=True) == [False, False]


def test_waiting_pair_solves_one_track_if_its_solution_is_old():
    assert told(tracks_of(1.1 * OLD_S, 1.2 * OLD_S), hurried=True) == [True, False]
    assert told(tracks_of(0.8 * OLD_S, 0.9 * OLD_S), hurried=True) == [True, True]


def test_track_never_solved_is_always_solved():
    assert told(tracks_of(math.inf, math.inf, 2 * OLD_S), hurried=True) == [False, False, True]


@pytest.mark.parametrize(('times', 'turn'), [(0.9, 1), (1.1, 0)])
def test_occluded_vehicle_waits_three_times_as_long_where_pairs_wait(times, turn):
    tracks = tracks_of(times * OCCLUDED_TIMES * 1.5 * OLD_S, 1.5 * OLD_S, occluded=[0])
    assert np.flatnonzero(~np.array(told(tracks, hurried=True))).tolist() == [turn]


def test_last_unhurried_pair_of_a_track_is_kept():
    first, second = tracks_of(1.1 * OLD_S, 1.2 * OLD_S)
    told([first, second], hurried=True)
    assert (first.unhurried_ns, second.unhurried_ns) == (None, NOW_NS)


def test_tracker_without_an_age_counts_from_its_last_unhurried_pair():
    hurries = SimpleNamespace(hurry=lambda hurried: None)
    track = Track(hurries, None, None, 0, None, None, None, confirmed=True)
    assert track.waited_s(NOW_NS) == math.inf
    track.unhurried_ns = NOW_NS - 10 ** 8
    assert track.waited_s(NOW_NS) == pytest.approx(0.1)
    assert Track(SimpleNamespace(), None, None, 0, None, None, None).waited_s(NOW_NS) == 0.0
