# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Passes measured in the background: same results in the same order, without delay of pairs."""
from __future__ import annotations

from dataclasses import replace
import threading
import time

import numpy as np
import pytest
from stereo_speed.core.passes import PassResult, Verdict
from stereo_speed.core.records import InitialFront, StereoPair, TrackState, TrackUpdate
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.io.bags import StereoBag
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.pipeline.conclusions import AtOnce, Beside, Later
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.pipeline.pipeline import SpeedPipeline
from stereo_speed.pipeline.run import run
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init


@pytest.fixture
def beside():
    one = Beside()
    yield one
    one.close()


def test_synchronous_measuring_leaves_nothing_waiting():
    one = AtOnce()
    one.add(lambda: 'a')
    assert one.done() == ['a']
    assert one.done() == []


def test_adding_does_not_wait_and_results_keep_their_order(beside):
    go = threading.Event()

    def slow():
        assert go.wait(30)
        return 'first'
    beside.add(slow)
    beside.add(lambda: 'second')
    assert beside.done() == []
    assert beside.waiting == 2
    go.set()
    assert beside.done(everything=True) == ['first', 'second']
    assert beside.waiting == 0


def test_error_is_raised_where_the_result_is_requested(beside):
    beside.add(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        beside.done(everything=True)


def test_error_does_not_affect_the_other_results(beside):
    for measure in (lambda: 'a', lambda: 1 // 0, lambda: 'b'):
        beside.add(measure)
    with pytest.raises(ZeroDivisionError):
        beside.done(everything=True)
    assert beside.waiting == 2
    assert beside.done(everything=True) == ['a', 'b'] and beside.waiting == 0


@pytest.mark.parametrize('way', [AtOnce, Beside])
def test_error_in_synchronous_measuring_is_raised_on_adding(way):
    one, failed = way(), []
    with pytest.raises(ZeroDivisionError):
        one.add(lambda: 1 // 0, lambda: failed.append('a'))
        one.done(everything=True)
    one.add(lambda: 'b', lambda: failed.append('b'))
    assert one.done(everything=True) == ['b'] and failed == ['a']
    one.close()


def test_deferred_passes_are_returned_once_in_order_without_waiting():
    go, told, one = threading.Event(), [], Later(lambda measure: measure().upper())
    one.add(lambda: go.wait(30) and 'first', lambda: told.append(0))
    one.add(lambda: 'second')
    assert told == [0] and one.done() == []
    first, second = one.pop()
    assert one.pop() == [] and not (first.done() or second.done())
    go.set()
    assert (first.result(), second.result()) == ('FIRST', 'SECOND')
    one.add(lambda: 'third')
    assert one.done(everything=True) == ['THIRD'] and one.done(everything=True) == []
    one.close()


def test_passes_are_measured_when_requested():
    asked = []
    one = Beside(measured=lambda measure: asked.append(measure) or measure())
    one.add(lambda: 'a')
    assert one.done(everything=True) == ['a'] and len(asked) == 1
    one.close()


def test_closing_drops_passes_that_have_not_begun():
    one, go, begun = Beside(), threading.Event(), []
    one.add(lambda: go.wait(30))
    one.add(lambda: begun.append(1))
    threading.Timer(0.1, go.set).start()
    one.close()
    assert begun == []


def test_failed_pass_affects_only_itself_with_an_error_handler():
    errors = []
    one = Beside(failed=errors.append)
    one.add(lambda: 'a')
    one.add(lambda: 1 // 0)
    one.add(lambda: 'b')
    assert one.done(everything=True) == ['a', 'b']
    assert [type(error) for error in errors] == [ZeroDivisionError]
    one.close()


@pytest.mark.parametrize('way', [Beside, Later])
def test_adding_to_a_full_queue_waits_for_its_first_pass(way):
    """So that the images of only a few passes are held in memory."""
    go, added = threading.Event(), threading.Event()
    one = way(most=2)

    def add():
        one.add(lambda: 'third')
        added.set()
    one.add(lambda: go.wait(30) and 'first')
    one.add(lambda: 'second')
    thread = threading.Thread(target=add)
    thread.start()
    assert not added.wait(0.2)
    go.set()
    thread.join(30)
    assert added.is_set() and one.done(everything=True) == ['first', 'second', 'third']
    one.close()


class Scripted:
    """A tracker that sees its vehicle in the first pairs, with a pass measured on request."""

    def __init__(self, request, pairs, go):
        self.track, self.ended, self._left, self._go = request.track, False, pairs, go
        self._front = request.front

    def update(self, pair):
        """Return a confirmed update, the last one with the end of the track."""
        self._left -= 1
        self.ended = self._left == 0
        return TrackUpdate(
            stamp_ns=pair.stamp_ns, track=self.track, lane='a', state=TrackState.CONFIRMED,
            speed_mps=20.0, speed_std_mps=0.1, s_m=5.0, lateral_m=0.0,
            position_m=np.array([0.0, 2.0, 40.0]), position_cov_m2=np.eye(3), axes=np.eye(3),
            quad_left_px=self._front.left_px, quad_right_px=self._front.right_px)

    def result(self):
        """Return the pass as soon as it may be measured."""
        assert self._go.wait(30)
        return PassResult(self.track, 'a', 0, 9, 5, 20.0, 0.1, Verdict.MEASURED, '', {}, {})


class Failing(Scripted):
    """A tracker whose pass cannot be measured."""

    def result(self):
        raise ZeroDivisionError


@pytest.fixture
def straight(make_scene):
    """Return a rig, a lane and a front on it."""
    rig = make_scene().rig
    corners_m = np.array([[x, y, 40.0] for x, y in ((-0.9, 1.2), (0.9, 1.2), (0.9, 2), (-0.9, 2))])
    front = InitialFront(0, *rig.project(corners_m)[:2])
    path = StraightPath(np.array([0.0, 2.0, 60.0]), np.array([0.0, 0.0, -1.0]), 40.0,
                        np.array([0.0, -1.0, 0.0]))
    return rig, LanePath('a', path, None, np.zeros(2), 0.0), front


def black_pairs(count):
    grey = np.zeros((768, 1024), np.uint8)
    return [StereoPair(k, 10**8 * (k + 1), 10**8 * (k + 1), grey, grey) for k in range(count)]


def test_failed_pass_is_not_awaited_again(straight):
    rig, lane, front = straight
    go, kinds, errors = threading.Event(), iter([Failing, Scripted]), []
    go.set()
    conclusions = Beside(failed=errors.append)
    pipeline = SpeedPipeline(
        rig, {'a': lane}, TrackerConfig(), lambda r: next(kinds)(r, 2, go),
        annotations=[front, front], conclusions=conclusions)
    passes = [p for pair in black_pairs(2) for p in pipeline.process(pair).passes]
    assert [p.track for p in passes + pipeline.finish()] == [1]
    assert [type(error) for error in errors] == [ZeroDivisionError]
    assert pipeline.open_tracks == set()
    conclusions.close()


def test_other_vehicles_do_not_wait_for_the_end_of_a_pass(beside, straight):
    """Its end is delayed; the next readings continue, and the pass comes later, unchanged."""
    rig, lane, front = straight
    go, lengths = threading.Event(), iter([2, 6])
    pipeline = SpeedPipeline(
        rig, {'a': lane}, TrackerConfig(), lambda r: Scripted(r, next(lengths), go),
        annotations=[front, front], conclusions=beside)
    steps = [pipeline.process(pair) for pair in black_pairs(5)]
    assert [[u.track for u in step.updates] for step in steps] == [[0, 1], [1], [1], [1], [1]]
    assert [step.passes for step in steps] == [[]] * 5 and beside.waiting == 1
    assert pipeline.open_tracks == {0, 1}
    go.set()
    assert [(p.track, p.speed_mps) for p in pipeline.finish()] == [(0, 20.0), (1, 20.0)]
    assert pipeline.open_tracks == set()


@pytest.mark.slow
def test_background_measuring_gives_the_same_result_on_the_sample(sample, beside):
    with StereoBag(sample / 'bag') as bag:
        pairs, rig = list(bag.pairs()), bag.rig
    place = MeasuringSite.of(load_site(sample / 'site.yaml'), rig)
    annotations = load_init(sample / 'init.yaml')
    one, other = (run(place.pipeline(PipelineConfig(), annotations, conclusions=way), pairs)
                  for way in (AtOnce(), beside))
    assert len(one.passes) == len(other.passes) == 1
    for field in ('speed_mps', 'speed_std_mps', 'smoothed', 'smoothed_std', 'budget', 'reason'):
        assert getattr(one.passes[0], field) == getattr(other.passes[0], field)


@pytest.mark.slow
def test_deferred_measuring_gives_the_same_result_on_the_sample(sample):
    """Pair by pair with its passes, even if one takes longer than some pairs."""
    site = load_site(sample / 'site.yaml')
    with StereoBag(sample / 'bag') as bag:
        place, seen = MeasuringSite.of(site, bag.rig), list(bag.pairs())
    told = []
    later = Later(lambda measure: time.sleep(0.5) or measure())
    for way in (None, later):
        pipeline, steps = place.pipeline(PipelineConfig(), conclusions=way), []
        done = run(pipeline, two_passes(seen), lambda pair, step: steps.append((
            pair.index, [(u.track, u.speed_mps) for u in step.updates],
            [(p.track, p.speed_mps, p.speed_std_mps) for p in step.passes])), later=way)
        told.append((steps, [(p.track, p.speed_mps) for p in done.passes], done.stamps_ns))
    later.close()
    assert told[0] == told[1]
    assert any(passes for _, _, passes in told[0][0]) and len(told[0][1]) == 2


def two_passes(seen):
    """Return the pairs twice, with an empty road in between."""
    empty = replace(seen[0], **{side: np.median([getattr(p, side) for p in seen], axis=0).astype(
        np.uint8) for side in ('left', 'right')})
    step_ns = seen[1].stamp_ns - seen[0].stamp_ns
    return [replace(pair, index=k, stamp_ns=k * step_ns, right_stamp_ns=k * step_ns)
            for k, pair in enumerate(seen + 6 * [empty] + seen)]
