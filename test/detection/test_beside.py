# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The detector in a separate process: same results as in sequence, and survival of its death."""
from __future__ import annotations

from dataclasses import astuple, replace
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from stereo_speed.core.tracker_config import EffortConfig, TrackerConfig
from stereo_speed.detection.beside import DetectorBeside, SearchProcess
from stereo_speed.detection.config import DetectorConfig, SpacingConfig
from stereo_speed.detection.detector import PlaneSweepDetector
from stereo_speed.detection.protocol import TrackedRegion
from stereo_speed.detection.spacing import Held, Place, Spacing
from stereo_speed.pipeline.assembly import make_pipeline
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath

END_S = 20.0
BEGIN = ('from stereo_speed.detection.beside import SearchProcess\n'
         'p = SearchProcess()\np.wait()\nprint(p.process.pid, flush=True)\ninput()')


@pytest.fixture(scope='module')
def standing():
    """Return a list of the process that the tests share; a second takes over from a dead one."""
    processes = []
    yield processes
    for process in processes:
        process.close()


@pytest.fixture()
def process(standing):
    """Return a process that is ready, as it comes from the test before."""
    if not standing or standing[-1].process.poll() is not None:
        standing.append(SearchProcess())
        standing[-1].wait()
    return standing[-1]


def both(drive, process, failed):
    """Return the detector in sequence, and the one in a process."""
    return (PlaneSweepDetector(drive.rig, drive.lanes, DetectorConfig()),
            DetectorBeside(process, drive.rig, drive.lanes, DetectorConfig(), failed))


def held(found):
    """Return the region of a track that follows a detection."""
    return TrackedRegion(
        lane=found.lane, s_m=found.s_m, lateral_m=found.lateral_m, width_m=found.width_m,
        height_m=found.height_m, left_px=found.left_px, right_px=found.right_px)


def assert_same(these, those):
    """Compare detections to the last bit; their earlier pairs must be identical objects."""
    assert len(these) == len(those)
    for one, other in zip(these, those):
        assert (one.earlier is None) == (other.earlier is None)
        if one.earlier is not None:
            assert all(a is b for a, b in zip(
                one.earlier.pairs, other.earlier.pairs, strict=True))
            for name in ('left_px', 'right_px'):
                assert (getattr(one.earlier, name) == getattr(other.earlier, name)).all()
        for a, b in zip(astuple(replace(one, earlier=None)), astuple(replace(other, earlier=None)),
                        strict=True):
            assert np.array_equal(a, b)


@pytest.mark.slow
def test_result_does_not_depend_on_the_expected_tracks(traffic, process):
    """Expected regions are the true ones, none, or wrong ones in turn; the true ones vary, too."""
    failures, found_ever = [], 0
    turn, beside = both(traffic, process, failures.append)
    known = []
    for k, pair in enumerate(traffic.pairs):
        tracked = known[-3:] if k % 4 else []
        if k % 3 < 2:
            beside.expect(pair, tracked if k % 3 else known)
        wanted = turn.update(pair, tracked)
        assert_same(beside.update(pair, tracked), wanted)
        known += [held(one) for one in wanted]
        found_ever += len(wanted)
        if k == len(traffic.pairs) // 2:  # a jump of time
            turn.reset(), beside.reset()
    assert found_ever > 5 and failures == []


@pytest.mark.slow
def test_pairs_without_a_search_are_not_sent(traffic, process, monkeypatch):
    """At 30 pairs/s two lanes take turns in six pairs, and time jumps once."""
    failures, sent, found = [], [], 0
    turn, beside = both(traffic, process, failures.append)
    monkeypatch.setattr(process, 'share', lambda pair, most: sent.append(number) or (
        SearchProcess.share(process, pair, most)))
    base = traffic.pairs[0].stamp_ns
    for number, pair in enumerate(traffic.pairs[k // 6] for k in range(60)):
        ns = base + number * 33_333_333 + (20_000_000_000 if number > 40 else 0)
        pair = replace(pair, index=number, stamp_ns=ns, right_stamp_ns=ns)
        if number == 50:  # a jump of time
            turn.reset(), beside.reset()
        beside.expect(pair, [])
        wanted = turn.update(pair)
        if number % 7 != 3:  # otherwise there is no request
            assert_same(beside.update(pair), wanted)
            found += len(wanted)
    assert found > 0 and failures == [] and 10 < len(sent) < 35


@pytest.mark.slow
@pytest.mark.parametrize('interval_s', [0.06, 1.0], ids=['rare', 'dense'])
def test_pipeline_measures_the_same_with_it(traffic, process, interval_s):
    failures, results = [], []
    config = PipelineConfig(TrackerConfig(effort=EffortConfig(solve_interval_s=interval_s)))
    for detect in (None, lambda *args: DetectorBeside(process, *args, failed=failures.append)):
        pipeline = make_pipeline(traffic.rig, traffic.lanes, config, detect=detect)
        steps = [pipeline.process(pair) for pair in traffic.pairs[:15]]
        results.append([(u.stamp_ns, u.track, u.speed_mps, u.speed_std_mps, u.s_m)
                        for step in steps for u in step.updates])
    assert results[0] == results[1] and results[0] and failures == []


def test_search_whose_result_is_no_longer_wanted_is_dropped(straight, process):
    failures, found = [], []
    _, beside = both(straight, process, failures.append)
    beside.expect(straight.pairs[0], [])
    beside.reset()
    for pair in straight.pairs:
        beside.expect(pair, [])
        if pair is not straight.pairs[2]:
            found += beside.update(pair)
    assert found and failures == []
    assert all(one.earlier.pairs[0] in straight.pairs for one in found if one.earlier is not None)


def test_result_of_a_previous_detector_is_not_used_by_the_next(straight, process):
    """As when the calibration changes during a search."""
    failures, found = [], 0
    _, before = both(straight, process, failures.append)
    before.expect(straight.pairs[3], [])
    turn, beside = both(straight, process, failures.append)
    for pair in straight.pairs:
        beside.expect(pair, [])
        wanted = turn.update(pair)
        assert_same(beside.update(pair), wanted)
        found += len(wanted)
    assert found and failures == []


def test_search_continues_here_when_the_process_dies(straight, process):
    failures = []
    turn, beside = both(straight, process, failures.append)
    pairs = straight.pairs
    for pair in pairs[:2]:
        assert_same(beside.update(pair), turn.update(pair))
    process.process.kill()
    process.process.wait(END_S)
    # The memory of the process is known here.
    for pair in pairs[2:]:
        beside.expect(pair, [])
        assert_same(beside.update(pair), turn.update(pair))
    assert len(failures) == 1


def test_searches_here_until_the_process_is_ready(straight, process):
    """The detector that continues remembers the earlier pairs."""
    failures, pairs = [], straight.pairs
    turn, beside = both(straight, None, failures.append)

    def compare(some):
        for pair in some:
            beside.expect(pair, [])
            assert_same(beside.update(pair), turn.update(pair))
    assert beside.is_here
    compare(pairs[:2])
    beside.move(process, failures.append)
    compare(pairs[2:4])
    assert not beside.is_here and failures == []
    process.process.kill()
    process.process.wait(END_S)
    compare(pairs[4:])
    assert beside.is_here and len(failures) == 1


@pytest.mark.slow
def test_moving_to_the_process_and_back_gives_the_same_result(traffic):
    """It moves with the fourth pair, in the middle of a round, and back after the ninth."""
    process, failures, asked, found = SearchProcess(), [], [], 0
    process.wait()
    turn = PlaneSweepDetector(traffic.rig, traffic.lanes, DetectorConfig())
    beside = DetectorBeside(
        None, traffic.rig, traffic.lanes, DetectorConfig(), failures.append,
        lambda: asked.append(0) or (process if len(asked) == 4 else None))
    try:
        for number, pair in enumerate(traffic.pairs[:15]):
            beside.expect(pair, [])
            if number == 9:
                process.process.kill()
                process.process.wait(END_S)
            wanted = turn.update(pair)
            assert_same(beside.update(pair), wanted)
            found += len(wanted)
            assert beside.is_here == (number not in range(3, 9))
        assert found > 1 and len(failures) == 1
    finally:
        process.close()


def test_unresponsive_process_is_waited_for_up_to_the_limit(straight):
    process, failures = SearchProcess(answer_s=0.3), []
    process.wait()
    try:
        turn, beside = both(straight, process, failures.append)
        os.kill(process.process.pid, signal.SIGSTOP)
        begun_s = time.monotonic()
        assert_same(beside.update(straight.pairs[0]), turn.update(straight.pairs[0]))
        assert time.monotonic() - begun_s > 0.3
        assert failures == ['no answer in 0.3 s']
    finally:
        os.kill(process.process.pid, signal.SIGCONT)
        process.close()
    assert process.process.returncode is not None


def test_process_ends_with_its_parent():
    with subprocess.Popen([sys.executable, '-c', BEGIN], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        parent.kill()
    end_s = time.monotonic() + END_S
    while Path(f'/proc/{pid}/cmdline').exists() and Path(f'/proc/{pid}/cmdline').read_text():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def test_recorded_queries_decide_whether_other_tracks_agree():
    """On a lane along z, 2 m ahead of a track is too near, 50 m is not."""
    path = StraightPath(np.zeros(3), np.array([0.0, 0.0, 1.0]), 100.0)
    spacing = Spacing({'lane': LanePath('lane', path, None, np.zeros(2), 0.0)}, SpacingConfig())
    places = {z: Place(np.array([0.0, 0.0, z]), 0.9, 'lane') for z in (10.0, 12.0, 60.0)}
    asked = Held(spacing, [places[10.0]])
    assert asked.meet('lane', places[12.0]) and not asked.meet('lane', places[60.0])
    asked.add(places[60.0])  # later detections count, without any request
    assert asked.meet('lane', places[60.0]) and not asked.anew().meet('lane', places[60.0])
    assert [question.answer for question in asked.asked] == [True, False, False, False]
    moved = Place(np.array([0.1, 0.0, 10.3]), 0.9, 'lane')
    assert spacing.agree(asked.asked, [moved])
    assert not spacing.agree(asked.asked, [])
    assert not spacing.agree(asked.asked, [moved, places[60.0]])
