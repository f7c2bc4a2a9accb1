# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Background solving: readings do not wait, and the result of a pass is the same."""
from __future__ import annotations

from collections import deque
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
import sys
import threading

import numpy as np
import pytest
from stereo_speed.core.passes import Reason, Verdict
from stereo_speed.core.records import TrackState
from stereo_speed.core.stamp_watch import StampWatch
from stereo_speed.core.tracker_config import TrackerConfig, VisibilityConfig
from stereo_speed.detection.protocol import Detection, EarlierFront
from stereo_speed.io.trace_json import trace_of, trace_record
from stereo_speed.pipeline.conclusions import Beside
from stereo_speed.pipeline.pipeline import SpeedPipeline
from stereo_speed.pipeline.solving import SolvingBeside
from stereo_speed.pipeline.track import start_of

from .scenes import automatic, project, start, two_abreast

SPEEDS_MPS = 22.352, 20.117


class WhenTold:
    """Solves on request, so that tests control what is late."""

    def __init__(self):
        self.tasks, self.waited, self.is_held_up = deque(), 0, False

    def submit(self, task, *, urgent=True):
        """Keep a task; urgent ones would go first, which no test here uses."""
        self.tasks.append((Future(), task))
        return self.tasks[-1][0]

    @contextmanager
    def held_up(self):
        """Record the delay: waiting for it now would take long."""
        self.is_held_up = True
        yield
        self.is_held_up = False

    def wait(self, future):
        """Run tasks until a given one is done."""
        assert not self.is_held_up
        self.waited += not future.done()
        while not future.done():
            assert self.tasks, 'nobody works on what is waited for'
            self.go(1)

    def go(self, most=100):
        """Run the next tasks, as a thread would."""
        for _ in range(min(most, len(self.tasks))):
            future, task = self.tasks.popleft()
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(task())
                except Exception as error:
                    future.set_exception(error)


@pytest.fixture(scope='module')
def dense(tmp_path_factory):
    """Two vehicles side by side at 30 pairs/s."""
    return two_abreast(tmp_path_factory.mktemp('dense'), fps=30.0, pairs=20)


def marked(dense, solving, config=TrackerConfig()):
    """Return a pipeline with both vehicles annotated."""
    sequence, lanes, marks = dense
    return SpeedPipeline(sequence.rig, lanes, config, start, annotations=marks, solving=solving)


def detected(dense):
    """Return a detection that makes a track count as found by a detector."""
    _, lanes, marks = dense
    return Detection(
        lane=next(iter(lanes)), left_px=marks[0].left_px, right_px=marks[0].right_px, std_px=0.7,
        s_m=0.0, lateral_m=0.0, width_m=1.8, height_m=0.8, speed_mps=None, speed_std_mps=None)


def until_busy(pipeline, solving, pairs):
    """
    Process pairs until one of two confirmed tracks is being solved and the other is not.

    :return: these two, and the remaining pairs, after one that came during the solution.
    """
    for k, pair in enumerate(pairs):
        pipeline.process(pair)
        tracks = pipeline._roster.tracks
        if k >= 8 and tracks[0].turn is not None:
            assert tracks[1].turn is not None and len(solving.tasks) == 2
            solving.go(1)
            pipeline.process(pairs[k + 1])
            return *sorted(tracks, key=lambda t: t.turn is None), pairs[k + 2:]
        solving.go()
    raise AssertionError('none has its turn')


def readings_of(step):
    """Return the readings of a step by track."""
    return {u.track: u for u in step.updates if u.state is TrackState.CONFIRMED}


def test_readings_do_not_wait_for_solutions(dense):
    solving = WhenTold()
    # After so few pairs the doubt whether it brakes withholds them at once.
    pipeline = marked(dense, solving, TrackerConfig(
        onset_per_s=0.0, visibility=VisibilityConfig(unnoticed_braking_mps2=0.0)))
    pairs = dense[0].pairs
    for pair in pairs[:8]:
        pipeline.process(pair)
        solving.go()
    stds = []
    for pair in pairs[8:11]:  # no solutions from now on
        early = []
        readings = readings_of(pipeline.process(pair, readings=early.extend))
        assert sorted(u.track for u in early) == sorted(readings) == [0, 1]
        for track, mps in enumerate(SPEEDS_MPS):
            reading = readings[track]
            assert reading.stamp_ns == pair.stamp_ns
            assert abs(reading.speed_mps - mps) < 4 * reading.speed_std_mps
            place = next(np.array([row[c] for c in 'xyz']) for row in dense[0].truth
                         if row['stamp_ns'] == pair.stamp_ns and row['vehicle'] == track)
            assert np.linalg.norm(reading.position_m - place) < 1.0
        stds.append([readings[k].speed_std_mps for k in range(2)])
    assert (np.diff(stds, axis=0) > 0).all()
    for pair in pairs[11:16]:  # until they are too uncertain
        step = pipeline.process(pair)
    assert len(step.updates) == 2 and not readings_of(step)
    solving.go()
    pipeline.process(pairs[16])
    solving.go()
    assert sorted(readings_of(pipeline.process(pairs[17]))) == [0, 1]


def test_passes_equal_those_of_synchronous_solving(dense):
    solving = WhenTold()
    pipeline = marked(dense, solving)
    for pair in dense[0].pairs:
        pipeline.process(pair)
        solving.go()
    at_once = marked(dense, None)
    for pair in dense[0].pairs:
        at_once.process(pair)
    for beside, other in zip(pipeline.finish(), at_once.finish(), strict=True):
        assert beside.verdict is other.verdict is Verdict.MEASURED
        assert beside.pairs == other.pairs == len(dense[0].pairs)
        assert abs(beside.speed_mps - other.speed_mps) < 0.3 * other.speed_std_mps
        assert beside.speed_std_mps == pytest.approx(other.speed_std_mps, rel=0.02)


def test_pairs_that_came_during_a_solution_are_fed_afterwards(dense):
    solving = WhenTold()
    pipeline = marked(dense, solving)
    for pair in dense[0].pairs[:8]:
        pipeline.process(pair)
        solving.go()
    pipeline.process(dense[0].pairs[8])
    assert len(solving.tasks) == 2  # both have their turns
    for pair in dense[0].pairs[9:12]:
        pipeline.process(pair)
    for result in pipeline.finish():
        stamps = [fed.stamp_ns for fed in result.trace.pairs]
        assert stamps == sorted(set(stamps))
        assert len(stamps) >= 10
        assert result.pairs == len(stamps)


def test_pass_can_be_recomputed_from_its_trace(dense):
    sequence, lanes, _ = dense
    solving = WhenTold()
    pipeline = marked(dense, solving)
    for k, pair in enumerate(sequence.pairs):
        pipeline.process(pair)
        if k % 3 == 0:  # late more often than not
            solving.go()
    for result in pipeline.finish():
        assert measured_again(dense, result).smoothed == result.smoothed


def measured_again(dense, result, config=TrackerConfig()):
    """Return a pass as recomputed from its trace."""
    sequence, lanes, _ = dense
    trace = trace_of(trace_record(result.trace), 'test')
    tracker = start(start_of(
        trace, sequence.rig, lanes[trace.lane], config, sequence.pairs[0]))
    by_stamp = {pair.stamp_ns: pair for pair in sequence.pairs}
    for fed in trace.pairs:
        if fed.particles is not None:
            tracker.share(fed.particles)
        tracker.hurry(fed.hurried)
        if fed.stamp_std_s is not None:
            tracker.doubt_stamps(fed.stamp_std_s)
        tracker.update(by_stamp[fed.stamp_ns])
    return tracker.result()


@pytest.mark.parametrize('every', [1, 3])
def test_trace_of_a_pair_contains_each_other_front_once(dense, every):
    solving = WhenTold()
    pipeline = marked(dense, solving)
    for k, pair in enumerate(dense[0].pairs):
        pipeline.process(pair)
        if k % every == 0:
            solving.go()
    for result in pipeline.finish():
        for fed in result.trace.pairs:
            assert [other.track for other in fed.others] == [1 - result.track]


def found(dense, k, **more):
    """Return a pipeline that detects the first vehicle from pair k on, and its detector."""
    sequence, _, marks = dense
    pipeline, finder = automatic(dense, [], set(range(k, len(sequence.pairs))), **more)

    def mark(pair):
        left, right = project(sequence, marks[0], pair.index)
        finder.marks = [replace(marks[0], left_px=left, right_px=right)]
    return pipeline, finder, mark


def test_found_vehicle_is_started_once_and_published(dense):
    """Its detector ignores what is held: it finds the vehicle again in each pair."""
    solving = WhenTold()
    pipeline, finder, mark = found(dense, 1, solving=solving)
    told = []
    for k, pair in enumerate(dense[0].pairs):
        mark(pair)
        told += readings_of(pipeline.process(pair)).values()
        if k % 2:
            solving.go()
    results = pipeline.finish()
    measured, = [r for r in results if r.verdict is Verdict.MEASURED]
    assert abs(measured.speed_mps - SPEEDS_MPS[0]) < 4 * measured.speed_std_mps
    assert {r.reason for r in results if r is not measured} <= {Reason.DUPLICATE}
    assert told and all(abs(u.speed_mps - SPEEDS_MPS[0]) < 4 * u.speed_std_mps for u in told)
    # The detector is told of tracks, so that it finds no second vehicle there.
    assert finder.occupied[-1]


def test_doubted_track_has_no_readings_even_when_extrapolated(dense):
    """The detector saw a speed that was half as high again."""
    solving = WhenTold()
    pipeline, finder, mark = found(dense, 1, solving=solving)
    finder.speed_mps, finder.std_share = 1.5 * SPEEDS_MPS[0], 0.01
    steps = []
    for pair in dense[0].pairs[:10]:
        mark(pair)
        steps.append(pipeline.process(pair))
        solving.go()
    assert any(step.updates for step in steps)
    assert not any(readings_of(step) for step in steps)


def test_vehicle_still_being_started_at_the_end_has_no_pass(dense):
    """Earlier pairs would confirm it at once if it had been started."""
    sequence, _, marks = dense
    passes = []
    for told in False, True:
        solving = WhenTold()
        pipeline, finder, mark = found(dense, 3, solving=solving)
        finder.earlier = EarlierFront(pairs=tuple(sequence.pairs[:3]), left_px=marks[0].left_px,
                                      right_px=marks[0].right_px)
        finder.speed_mps = 22.0
        for pair in sequence.pairs[:5]:
            mark(pair)
            pipeline.process(pair)
        assert len(solving.tasks) == 1  # the vehicle found in pair 3 is being started
        if told:
            solving.go()
            mark(sequence.pairs[5])
            assert pipeline.process(sequence.pairs[5]).updates
        passes.append(len(pipeline.finish()))
    assert passes == [0, 1]


def test_background_error_affects_only_its_track(dense, monkeypatch):
    """It is reported like a pass that cannot be measured."""
    solving, errors = WhenTold(), []
    sequence, lanes, marks = dense
    for at_end in False, True:
        conclusions = Beside(failed=errors.append)
        pipeline = SpeedPipeline(sequence.rig, lanes, TrackerConfig(), start, annotations=marks,
                                 solving=solving, conclusions=conclusions)
        for pair in sequence.pairs[:8]:
            pipeline.process(pair)
            solving.go()
        broken, sound = pipeline._roster.tracks
        with monkeypatch.context() as patch:
            patch.setattr(broken.tracker, 'update', lambda pair: 1 / 0)
            patch.setattr(broken.tracker, 'carry', lambda pair: None)
            pipeline.process(sequence.pairs[8])
            if not at_end:
                solving.go()
                for pair in sequence.pairs[9:]:
                    assert {u.track for u in pipeline.process(pair).updates} == {
                        sound.tracker.track}
                    solving.go()
            results = pipeline.finish()
        conclusions.close()
        assert [r.track for r in results] == [sound.tracker.track]
        assert isinstance(errors.pop(), ZeroDivisionError) and not errors


def test_unconfirmed_track_that_misses_a_pair_ends(dense, monkeypatch):
    solving = WhenTold()
    pipeline, _, mark = found(dense, 1, solving=solving)
    for pair in dense[0].pairs[:4]:
        mark(pair)
        pipeline.process(pair)
        solving.go()
    track, = pipeline._roster.tracks
    assert not track.confirmed
    seen = track.tracker.update
    monkeypatch.setattr(track.tracker, 'update', lambda pair: replace(
        seen(pair), state=TrackState.COASTING))
    pipeline.process(dense[0].pairs[4])
    solving.go()
    pipeline.process(dense[0].pairs[5])
    assert track not in pipeline._roster.tracks


def test_duplicate_track_ends_after_its_last_reading(dense):
    solving = WhenTold()
    sequence, lanes, marks = dense
    pipeline = marked(dense, solving)
    for pair in sequence.pairs[:8]:
        pipeline.process(pair)
        solving.go()
    pipeline.process(sequence.pairs[8])
    busy = next(t for t in pipeline._roster.tracks if t.turn is not None)
    other = next(t for t in pipeline._roster.tracks if t is not busy)
    # Its reported position is that of the other one.
    busy.detection = detected(dense)
    busy.last = replace(other.last, state=TrackState.COASTING)
    pipeline._endings.drop_doubles(sequence.pairs[8].stamp_ns)
    assert pipeline._roster.tracks == [other]
    assert busy.tracker.track in pipeline.open_tracks
    solving.go()
    ended, = pipeline.process(sequence.pairs[9]).passes
    assert (ended.track, ended.reason) == (busy.tracker.track, Reason.DUPLICATE)
    assert len(ended.trace.pairs) == 9


def test_step_of_the_clock_waits_for_solutions_under_way(dense):
    """A detected vehicle ends with all its readings; an annotated one continues."""
    solving = WhenTold()
    pipeline, pairs = marked(dense, solving), dense[0].pairs
    period_ns = pairs[1].stamp_ns - pairs[0].stamp_ns
    for k in range(20, 0, -1):
        pipeline.doubt.stamps.add(pairs[0].stamp_ns - k * period_ns)
    busy, other, rest = until_busy(pipeline, solving, pairs)
    busy.detection, turn_ns = detected(dense), busy.turn.pair.stamp_ns
    ns = rest[0].stamp_ns + 20_000_000
    step = pipeline.process(replace(rest[0], stamp_ns=ns, right_stamp_ns=ns))
    assert solving.waited == 1
    ended, = step.passes
    assert (ended.track, ended.reason) == (busy.tracker.track, Reason.STAMPS_UNCERTAIN)
    for fed, ns in zip(ended.trace.pairs[-2:], (turn_ns, turn_ns + period_ns), strict=True):
        assert fed.stamp_ns == fed.update.stamp_ns == pytest.approx(ns, abs=1000)
    assert [u.track for u in step.updates] == [other.tracker.track] and not readings_of(step)
    assert pipeline._roster.tracks == [other]


def test_solutions_are_awaited_where_the_views_have_two_stamps(dense):
    """Positions in the right view are known only when its times are."""
    solving = WhenTold()
    pipeline = marked(dense, solving)
    busy, _, rest = until_busy(pipeline, solving, dense[0].pairs)
    turn_ns, right_ns = busy.turn.pair.stamp_ns, rest[0].stamp_ns + 5_000_000
    step = pipeline.process(replace(rest[0], right_stamp_ns=right_ns))
    assert pipeline.doubt.lag.concerned and len(step.updates) == 2
    assert solving.waited == 1 and not solving.tasks
    last = dense[0].pairs[len(dense[0].pairs) - len(rest) - 1]  # of those before, in its turn
    assert [fed.stamp_ns for fed in busy.trace.built().pairs[-3:]] == [
        turn_ns, last.stamp_ns, rest[0].stamp_ns]
    pipeline.process(rest[1])  # of one trigger again
    pipeline.process(rest[2])
    assert solving.tasks and solving.waited == 1


def uneven_until(ns, period_ns):
    """Return a stamp watch that has seen every other stamp 4 ms late, until a coming one."""
    watch = StampWatch()
    for k in range(20, 0, -1):
        watch.add(ns - k * period_ns + 4_000_000 * (k % 2))
    return watch


@pytest.mark.parametrize('more', [0, 100])
def test_track_being_solved_learns_of_its_stamps_without_waiting(dense, more):
    """It learns of them after its solution, with which the stream may end as well."""
    solving, pairs = WhenTold(), dense[0].pairs
    # Of a third of a second, too, in which braking would not show; whether the images speak for
    # the stamps is another question.
    config = TrackerConfig(max_speed_std_share=1.0, exposure_odds=1e6, onset_per_s=0.0)
    pipeline, at_once = marked(dense, solving, config), marked(dense, None, config)
    busy, other, rest = until_busy(pipeline, solving, pairs)
    period_ns, even_mps = pairs[1].stamp_ns - pairs[0].stamp_ns, busy.last.speed_std_mps
    pipeline.doubt.stamps = uneven_until(rest[0].stamp_ns, period_ns)
    step = pipeline.process(rest[0])
    assert not solving.waited and busy.turn is not None
    assert busy.stamp_std_s is None and other.stamp_std_s == pipeline.uneven_stamps_s > 0.002
    said, = (u for u in step.updates if u.track == busy.tracker.track)
    assert said.speed_std_mps > 3.0 * even_mps  # its 1-sigma is increased nevertheless
    turn_ns = busy.turn.pair.stamp_ns
    for pair in rest[1:1 + more]:
        solving.go()
        pipeline.process(pair)
        assert busy.stamp_std_s > 0.002
    results = pipeline.finish()
    for pair in pairs[:len(pairs) - len(rest) + 1 + more]:
        if pair is rest[0]:
            at_once.doubt.stamps = uneven_until(pair.stamp_ns, period_ns)
        at_once.process(pair)
    for result, same in zip(results, at_once.finish(), strict=True):
        assert result.budget.stamps_mps == pytest.approx(same.budget.stamps_mps, rel=0.3)
        assert result.speed_std_mps == pytest.approx(same.speed_std_mps, rel=0.3)
    said = next(r for r in results if r.track == busy.tracker.track).trace.pairs
    assert {fed.stamp_std_s for fed in said[:-1] if fed.stamp_ns <= turn_ns} == {None}
    assert said[-1].stamp_std_s > 0.002
    for result in results:
        again = measured_again(dense, result, config).smoothed
        assert again == (result.smoothed if more else pytest.approx(result.smoothed, abs=1e-3))


def test_started_track_is_in_the_trace_of_the_pairs_that_it_has_seen(dense):
    """It missed the pairs of the meantime: neither trace has the other vehicle there."""
    solving = WhenTold()
    pipeline, finder, mark = found(dense, 8, solving=solving, annotations=dense[2][1:])
    finder.pairs, pairs = {8}, dense[0].pairs
    for k, pair in enumerate(pairs):
        mark(pair)
        pipeline.process(pair)
        if not 9 <= k < 12:
            solving.go()
    old, new = (result.trace.pairs for result in pipeline.finish())
    stamps = [pair.stamp_ns for pair in pairs]
    assert [fed.stamp_ns for fed in new] == [stamps[8], *stamps[13:]]
    assert all([front.track for front in fed.others] == [0] for fed in new)
    assert {fed.stamp_ns for fed in old if fed.others} == {fed.stamp_ns for fed in new}
    assert all([front.track for front in fed.others] == [1] for fed in old if fed.others)
    assert len(old) > len(new) + 8


def test_solution_replaces_the_expected_place_in_the_trace(dense):
    """In the trace of a vehicle found in that pair and started before the solution."""
    solving = WhenTold()
    pipeline, finder, mark = found(dense, 0, solving=solving, annotations=dense[2][1:])
    finder.pairs, pairs = set(), iter(dense[0].pairs)
    for k, pair in enumerate(pairs):
        pipeline.process(pair)
        solving_for = pipeline._roster.tracks[0].turn
        solving.go()
        if k >= 8 and solving_for is not None:
            break
    pipeline.process(next(pairs))  # it is solved for in every other pair
    shown = next(pairs)
    finder.pairs = {shown.index}
    mark(shown)
    pipeline.process(shown)
    pipeline.process(next(pairs))
    solving.tasks.rotate(1)
    solving.go(1)  # which starts the track of the detection
    pipeline.process(next(pairs))
    known, new = pipeline._roster.tracks
    assert known.turn.pair.stamp_ns == shown.stamp_ns
    expected_px = known.turn.expected[shown.stamp_ns].quad_left_px
    solving.go()
    pipeline.process(next(pairs))
    fed = new.trace.built().pairs[0]
    said, = (p.update for p in known.trace.built().pairs if p.stamp_ns == shown.stamp_ns)
    assert fed.stamp_ns == shown.stamp_ns
    assert [front.track for front in fed.others] == [0]
    assert np.array_equal(fed.others[0].left_px, said.quad_left_px)
    assert not np.array_equal(expected_px, said.quad_left_px)


def test_lost_pair_does_not_block(dense):
    solving = WhenTold()
    pipeline = marked(dense, solving)
    for k, pair in enumerate(dense[0].pairs):
        if k < 8:
            pipeline.process(pair)
            solving.go()
        elif k % 4:
            pipeline.process(pair)
    assert solving.tasks and not solving.waited


def test_tracker_that_cannot_extrapolate_is_solved_at_once(dense):
    class Plain:
        """A tracker with only the required methods."""

        def __init__(self, tracker):
            self.tracker, self.track = tracker, tracker.track
            self.update, self.result = tracker.update, tracker.result

        @property
        def ended(self):
            """Return whether the pass is over."""
            return self.tracker.ended
    sequence, lanes, marks = dense
    solving = WhenTold()
    pipeline = SpeedPipeline(sequence.rig, lanes, TrackerConfig(), lambda begun: Plain(
        start(begun)), annotations=marks, solving=solving)
    for pair in sequence.pairs[:8]:
        step = pipeline.process(pair)
        assert not solving.tasks
    assert sorted(readings_of(step)) == [0, 1]


def test_solution_half_a_second_late_is_awaited(dense):
    solving = WhenTold()
    pipeline = marked(dense, solving)
    worked_on = []
    for k, pair in enumerate(dense[0].pairs):
        pipeline.process(pair)
        if k < 2:
            solving.go()
        worked_on.append([t.turn.pair.stamp_ns for t in pipeline._roster.tracks if t.turn])
        assert all(pair.stamp_ns - ns <= 500_000_000 for ns in worked_on[-1])
    # No solution was requested from pair 2 on.
    assert worked_on[2] == worked_on[15] != worked_on[-1]


def test_widely_spaced_pairs_are_solved_in_order(tmp_path):
    scene = two_abreast(tmp_path, pairs=6)
    solving = WhenTold()
    pipeline = marked(scene, solving)
    for pair in scene[0].pairs:
        step = pipeline.process(pair)
        assert not solving.tasks and len(step.updates) == 2


def test_thread_gives_the_same_results_as_explicit_solving(dense):
    """Both when it solves between pairs and when pairs wait for it."""
    told, thread = WhenTold(), SolvingBeside()
    results = []
    try:
        for solving, go in (told, told.go), (thread, lambda: thread.wait(
                thread.submit(lambda: None))):
            pipeline = marked(dense, solving)
            for pair in dense[0].pairs:
                pipeline.process(pair)
                go()
            results.append([r.smoothed for r in pipeline.finish()])
    finally:
        thread.close()
    assert results[0] == results[1]


def test_extrapolation_does_not_change_the_result(dense):
    sequence, lanes, marks = dense
    asked, left = (SpeedPipeline(sequence.rig, lanes, TrackerConfig(), start, annotations=marks)
                   for _ in range(2))
    for pair, after in zip(sequence.pairs[:10], sequence.pairs[1:11]):
        one, other = asked.process(pair), left.process(pair)
        assert [(u.speed_mps, u.s_m) for u in one.updates] == [
            (u.speed_mps, u.s_m) for u in other.updates]
        for track in asked._roster.tracks:
            track.tracker.expected(after)
    assert [r.smoothed for r in asked.finish()] == [r.smoothed for r in left.finish()]


def test_extrapolation_during_a_solution_does_not_change_the_result(dense):
    """Threads are switched as often as possible."""
    sequence, lanes, marks = dense
    asked, left = (SpeedPipeline(sequence.rig, lanes, TrackerConfig(), start, annotations=marks)
                   for _ in range(2))
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        with ThreadPoolExecutor(1) as thread:
            for pair, after in zip(sequence.pairs[:12], sequence.pairs[1:13]):
                trackers = [track.tracker for track in asked._roster.tracks]
                solved = thread.submit(asked.process, pair)
                expected = []
                while not solved.done():
                    expected += [tracker.expected(after) for tracker in trackers]
                assert [(u.speed_mps, u.s_m) for u in solved.result().updates] == [
                    (u.speed_mps, u.s_m) for u in left.process(pair).updates]
                for update in filter(None, expected):
                    assert update.stamp_ns == after.stamp_ns and np.isfinite(update.speed_std_mps)
    finally:
        sys.setswitchinterval(interval_s)
    assert [r.smoothed for r in asked.finish()] == [r.smoothed for r in left.finish()]


def test_urgent_tasks_go_first_but_not_forever():
    solving, held, order = SolvingBeside(), threading.Event(), []
    try:
        first = solving.submit(lambda: held.wait(30.0))
        tasks = [solving.submit(partial(order.append, 'new'), urgent=False)]
        tasks += [solving.submit(partial(order.append, k)) for k in range(5)]
        held.set()
        for task in [first, *tasks]:
            solving.wait(task)
    finally:
        solving.close()
    assert order == [0, 1, 2, 'new', 3, 4]


def test_tasks_not_begun_at_closing_are_dropped():
    solving, held = SolvingBeside(), threading.Event()
    running = solving.submit(lambda: held.wait(30.0))
    never = solving.submit(lambda: 1 / 0)
    closing = threading.Thread(target=solving.close)
    closing.start()
    with pytest.raises(CancelledError):
        never.result(30.0)
    held.set()
    closing.join(30.0)
    assert not closing.is_alive() and running.result()
