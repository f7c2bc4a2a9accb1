# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The loop over pairs: what it gathers, in which order, and what it drops."""
from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.core.passes import PassResult, Verdict
from stereo_speed.core.records import StereoPair, TrackState, TrackUpdate
from stereo_speed.pipeline.pipeline import Step
from stereo_speed.pipeline.run import MOST_UNTOLD, MOST_UNTOLD_BYTES, run

UPDATE = TrackUpdate(
    stamp_ns=0, track=0, lane='lane', state=TrackState.CONFIRMED, speed_mps=20.0,
    speed_std_mps=0.1, s_m=0.0, lateral_m=0.0, position_m=np.zeros(3),
    position_cov_m2=np.eye(3), axes=np.eye(3), quad_left_px=np.zeros((4, 2)),
    quad_right_px=np.zeros((4, 2)))
PASS = PassResult(track=0, lane='lane', first_ns=0, last_ns=1, pairs=1, speed_mps=20.0,
                  speed_std_mps=0.1, verdict=Verdict.MEASURED, reason='', smoothed={},
                  smoothed_std={})


def pairs(count):
    """Return pairs without images."""
    blank = np.zeros((2, 2), np.uint8)
    return [StereoPair(k, 10 * k, 10 * k, blank, blank) for k in range(count)]


def scripted(steps, at_end):
    """Return a pipeline with scripted output."""
    waiting = iter(steps)
    return SimpleNamespace(process=lambda pair: next(waiting), finish=lambda: at_end)


def test_updates_of_discarded_tracks_are_left_out():
    two = replace(UPDATE, track=1)
    done = run(scripted([Step([UPDATE, two], []), Step([two], [])], [PASS]), pairs(2))
    assert done.updates == [UPDATE] and done.passes == [PASS]
    assert done.stamps_ns == [0, 10]


def test_passes_are_sorted_by_track_whenever_they_end():
    later, last = replace(PASS, track=2), replace(PASS, track=1)
    done = run(scripted([Step([], [later]), Step([], [])], [PASS, last]), pairs(2))
    assert [p.track for p in done.passes] == [0, 1, 2]


def test_observer_gets_every_pair_with_its_results():
    steps, seen = [Step([UPDATE], []), Step([], [PASS]), Step([], [])], []
    run(scripted(steps, []), pairs(3), lambda pair, step: seen.append((pair.index, step)))
    assert seen == list(enumerate(steps))


class Awaited(Future):
    """A pass that is measured when its result is awaited."""

    def result(self, timeout=None):
        """Return the result."""
        return PASS


@pytest.mark.parametrize(('image_bytes', 'most'), [
    (4, MOST_UNTOLD), (MOST_UNTOLD_BYTES // 20, 10), (MOST_UNTOLD_BYTES, 0)])
def test_number_of_waiting_pairs_is_limited_by_their_memory(image_bytes, most):
    image, told, waiting = np.broadcast_to(np.uint8(0), (1, image_bytes)), [], []
    seen = [replace(pair, left=image, right=image) for pair in pairs(MOST_UNTOLD + 10)]

    def process(pair):
        waiting.append(pair.index - len(told))
        return Step([], [])
    later = SimpleNamespace(pop=lambda: [Awaited()])
    done = run(SimpleNamespace(process=process, finish=list), seen,
               lambda pair, step: told.append((pair.index, len(step.passes))), later=later)
    assert max(waiting) == most
    assert told == [(pair.index, 1) for pair in seen] and len(done.passes) == len(seen)


def test_time_in_the_pipeline_is_counted():
    def busy(pair):
        sum(k * k for k in range(200_000))
        return Step([], [])
    done = run(SimpleNamespace(process=busy, finish=list), pairs(2))
    assert 0 < done.cpu_s < done.wall_s + 0.05


def test_no_pairs_give_empty_results():
    done = run(scripted([], []), [])
    assert (done.updates, done.passes, done.stamps_ns) == ([], [], [])


class Sink:
    """Counts the items it is given."""

    def __init__(self):
        self.updates, self.passes = 0, []

    def add(self, updates, passes, open_tracks):
        self.updates += len(updates)
        self.passes += passes


def test_with_a_sink_only_the_first_vehicles_are_kept_in_memory():
    """Each of 30 vehicles is in 4 pairs; every other track was no vehicle."""
    steps, speeds = [], {}
    for k in range(30):
        seen = [10 * (4 * k + n) for n in range(4)]
        speeds[2 * k] = {ns: 20.0 + (ns == seen[1]) for ns in seen}
        ended = [replace(PASS, track=2 * k - 2, smoothed=speeds[2 * k - 2])] if k else []
        steps += [Step([replace(UPDATE, track=2 * k + odd, stamp_ns=ns) for odd in (0, 1)],
                       ended if ns == seen[0] else []) for ns in seen]
    last = replace(PASS, track=58, smoothed=speeds[58])
    pipeline, sink, waiting = scripted(steps, [last]), Sink(), iter(steps)

    def process(pair):
        pipeline.open_tracks = {2 * (pair.index // 4)}
        return next(waiting)
    pipeline.process = process
    done = run(pipeline, pairs(len(steps)), sink=sink, most_updates=40)
    assert sink.updates == 2 * len(steps)
    assert [p.track for p in done.passes] == [p.track for p in sink.passes] == [*range(0, 60, 2)]
    assert 0 < len(done.updates) <= 40
    assert {u.track for u in done.updates} == set(done.kept)
    assert all(len([u for u in done.updates if u.track == t]) == 4 for t in done.kept)
    for one in done.passes:
        assert one.profile_mps == (20.0, 20.0, 21.0)
        assert len(one.smoothed) == (4 if one.track in done.kept else 3)
