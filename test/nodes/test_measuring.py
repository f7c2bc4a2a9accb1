# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a measuring node as its states change, in this process."""
from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy')

from rclpy.lifecycle import TransitionCallbackReturn  # noqa: E402, I100
from stereo_speed.core.errors import SiteError  # noqa: E402
from stereo_speed.io.bags import StereoBag  # noqa: E402
from stereo_speed.nodes import measuring_thread  # noqa: E402
from stereo_speed.nodes.health import WARN  # noqa: E402
from stereo_speed.nodes.measuring_thread import MeasuringThread  # noqa: E402
from stereo_speed.nodes.tracker import TrackerNode  # noqa: E402
from stereo_speed.nodes.worker import Worker  # noqa: E402
from stereo_speed.pipeline.conclusions import OnlyHereError  # noqa: E402
from stereo_speed.pipeline.pass_process import PassProcessError  # noqa: E402


class Failing:
    """Stands in for the process of the passes; records whether it was closed."""

    def __init__(self, error):
        self.error, self.closed, self.asked = error, False, 0

    def wait(self):
        """Be ready."""

    def measured(self, measure):
        """Raise its error."""
        self.asked += 1
        raise self.error

    def close(self, most_s=0.0):
        """Remember the call."""
        self.closed = True


def given(node, error):
    """Give a node a failing process for its passes, and return it."""
    process, workers = Failing(error), node.measuring.context.workers
    workers.passer = Worker('measures passes', lambda: process, node.measuring.log)
    workers.passer.start(), workers.passer.wait()
    return process


@pytest.fixture()
def node(in_process, sample):
    with in_process(TrackerNode, f'site:={sample / "site.yaml"}') as node:
        yield node


def test_each_state_and_a_jump_of_time_are_reported(node):
    measuring = node.measuring
    assert (measuring.state().level, measuring.state().message) == (WARN, 'not configured')
    node.trigger_configure()
    assert (measuring.state().level, measuring.state().message) == (WARN, 'inactive')
    node.trigger_activate()
    assert 'inactive' not in measuring.state().message
    assert 'not checked yet' in measuring.stamps().message  # and none are said to be right
    for ns in (6, 5):
        measuring.thread._mind_time(SimpleNamespace(reset=lambda: None), ns)
    state = measuring.state()
    assert state.values['resets'] == 1 and 'stamps jumped back' in state.message
    node.trigger_deactivate()
    assert measuring.state().message == 'inactive'


def test_pairs_that_come_long_before_the_calibration_are_not_told_as_overload(node):
    """The newest 50 are kept; the machine keeps up all the while."""
    node.trigger_configure()
    node.trigger_activate()
    measuring, thread = node.measuring, node.measuring.thread
    for k in range(60):
        thread._take(SimpleNamespace(ns=k, index=k, came_s=0.0))
    assert (thread._counts.early.total, thread._counts.skipped.total) == (10, 0)
    assert [arrival.ns for arrival in thread._waiting] == list(range(10, 60))
    assert 'pairs were too old when measuring began: 10' in measuring.state().message
    thread._waiting.clear()


def test_site_is_refined_by_pairs_of_the_calibrated_size_only(in_process, sample, monkeypatch):
    """A camera that is being set up may send images of half the size until it is."""
    with StereoBag(sample / 'bag') as bag:
        rig, full = bag.rig, next(iter(bag.pairs()))
    half = replace(full, left=full.left[::2, ::2], right=full.right[::2, ::2])
    with in_process(TrackerNode, f'site:={sample / "site.yaml"}', 'refine_site_pairs:=3') as node:
        node.trigger_configure()
        thread = MeasuringThread(node.measuring.context, node.measuring.configuration)
        thread._calibration.current = 1, rig
        given = []

        def of(site, rig, pairs, config):
            given.extend(pairs)
            raise SiteError('site', 'lines', 'enough', 'to end this test')
        monkeypatch.setattr(measuring_thread, 'MeasuringSite', SimpleNamespace(of=of))
        monkeypatch.setattr(thread._admission, 'begin', lambda rig, pair: None)
        for k, pair in enumerate((half, half, full, replace(full, right=half.right), full)):
            thread._take(SimpleNamespace(ns=k, index=k, came_s=0.0, pair=lambda _, one=pair: one))
        assert not given and [arrival.ns for arrival in thread._waiting] == [2, 4]
        with pytest.raises(SiteError, match='to end this test'):
            thread._take(SimpleNamespace(ns=5, index=5, came_s=0.0, pair=lambda _: full))
        assert [pair is full for pair in given] == [True] * 3
        assert 'refused' in thread.state().message
        thread._waiting.clear()


@pytest.mark.parametrize('fails', [False, True])
def test_pipeline_is_told_the_stamps_of_skipped_pairs(node, fails):
    """Whatever happens, none of them ends the node."""
    node.trigger_configure()
    thread = MeasuringThread(node.measuring.context, node.measuring.configuration)
    counts, told = node.measuring.context.counts, []

    def pass_over(ns):
        told.append(ns)
        if fails:
            raise RuntimeError('some error')
    thread.pipeline = SimpleNamespace(
        pass_over=pass_over, reset=partial(told.append, 'reset'), finish=list)
    for ns in (5, 7, 6):
        thread._pass_over(ns)
    failed = ['reset'] * fails
    assert told == [5, *failed, 7, *failed, 'reset', 6, *failed]  # time jumped back to 6
    assert (counts.resets.total, counts.failed.total) == (1, 3 * fails)


@pytest.mark.parametrize(('every', 'told'), [(3, False), (1, True)])
def test_hurrying_most_pairs_is_reported(node, every, told):
    node.trigger_configure()
    node.trigger_activate()
    for k in range(30):
        node.measuring.context.counts.measured.add()
        node.measuring.context.counts.hurried.add(k % every == 0)
    state = node.measuring.state()
    assert ('measuring barely keeps up: most pairs are hurried' in state.message) is told
    assert state.level == WARN or not told


def test_with_hurrying_disabled_no_pair_is_hurried(in_process, sample):
    with in_process(TrackerNode, f'site:={sample / "site.yaml"}', 'hurry:=false') as node:
        node.trigger_configure()
        node.trigger_activate()
        node.trigger_deactivate()  # its thread takes no pairs from here on
        queue, now_s = node.measuring.thread.queue, [0.0]
        queue._clock = lambda: now_s[0]
        queue.put('pair', 0)
        now_s[0] = 1.0
        assert queue.take(0.0) == 'pair' and not queue.hurried


def test_pass_that_cannot_be_sent_to_the_process_is_measured_here(node):
    process = given(node, OnlyHereError('cannot be pickled'))
    workers = node.measuring.context.workers
    for _ in range(2):
        assert workers.measured(lambda: 'result') == 'result'
    assert (process.asked, process.closed, workers.passer.fault) == (2, False, '')


def test_failed_pass_process_is_closed_reported_and_not_used_again(node):
    process = given(node, PassProcessError('it has ended'))
    for _ in range(2):
        assert node.measuring.context.workers.measured(lambda: 'result') == 'result'
    assert (process.asked, process.closed) == (1, True)
    node.trigger_configure()
    node.trigger_activate()
    given(node, PassProcessError('it has ended'))
    node.measuring.context.workers.measured(lambda: 'result')
    state = node.measuring.state()
    assert state.level == WARN
    assert 'measures passes without a separate process: it has ended' in state.message
    node.trigger_deactivate()


def test_configuring_that_fails_midway_leaves_the_node_as_it_was(in_process, sample):
    wrong = 'qos_overrides./right/camera_info.subscription.depth:=deep'
    with in_process(TrackerNode, f'site:={sample / "site.yaml"}', wrong) as node:
        assert node.trigger_configure() is TransitionCallbackReturn.ERROR
        assert 'deep' in str(node._error)
        assert node.measuring.state().message == 'not configured'
        assert node.measuring._infos == [] and node.count_subscribers('/left/camera_info') == 0
