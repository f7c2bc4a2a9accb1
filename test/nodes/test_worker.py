# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A node's worker process: its failures, and its restarts."""
from __future__ import annotations

import pytest

pytest.importorskip('rclpy')

from stereo_speed.nodes.worker import LONGEST_PAUSE_S, PAUSE_S, Worker  # noqa: E402, I100


class Process:
    """Stands in for a process; ``ready`` is None where it has ended."""

    def __init__(self, ready=True):
        self.ready, self.closed = ready, False

    def is_ready(self):
        """Return whether it is ready, or raise."""
        if self.ready is None:
            raise BrokenPipeError('it has ended')
        return self.ready

    def wait(self):
        """Be ready, or raise."""
        self.is_ready()

    def close(self, most_s=0.0):
        """Remember the call."""
        self.closed = True


class Log:
    """Records log lines."""

    def __init__(self):
        self.lines = []
        self.error = self.info = self.lines.append


class Case:
    """A worker whose processes and clock are set by a test."""

    def __init__(self):
        self.now_s, self.made, self.next, self.log = 0.0, [], Process(), Log()
        self.worker = Worker('works', self.make, self.log, lambda: self.now_s)

    def make(self):
        """Start the next process, or raise it."""
        if isinstance(self.next, OSError):
            raise self.next
        self.made.append(self.next)
        self.next = Process()
        return self.made[-1]

    def revived_after(self, least_s):
        """Return the time until another process is started, with checks every 10 ms."""
        count, begun_s = len(self.made), self.now_s
        while len(self.made) == count:
            self.now_s += 0.01
            assert self.now_s < begun_s + 2 * least_s + 1.0
            self.worker.revive()
        return self.now_s - begun_s


@pytest.fixture()
def case():
    return Case()


def test_worker_can_be_used_once_it_is_ready(case):
    case.worker.start()
    assert case.worker.process is None
    case.worker.wait()
    assert case.worker.process is case.made[0]
    assert (case.worker.fault, case.log.lines) == ('', [])


def test_failed_process_is_closed_reported_and_restarted(case):
    case.worker.start(), case.worker.wait()
    case.worker.failed(case.made[0], 'it has ended')
    assert case.made[0].closed and case.worker.process is None
    assert case.worker.fault == 'works without a separate process: it has ended'
    case.next = Process(ready=False)
    assert case.revived_after(PAUSE_S) == pytest.approx(PAUSE_S, abs=0.02)
    case.worker.revive()
    assert case.worker.process is None and case.worker.fault
    case.made[1].ready = True
    case.worker.revive()
    assert case.worker.process is case.made[1] and case.worker.fault == ''
    assert case.log.lines[1:] == ['works in a separate process again']


def test_repeated_failures_are_restarted_less_and_less_often(case):
    case.worker.start(), case.worker.wait()
    pauses_s = []
    for _ in range(9):
        case.worker.failed(case.worker.process, 'it has ended')
        pauses_s.append(case.revived_after(LONGEST_PAUSE_S))
        case.worker.revive()
    assert pauses_s == pytest.approx([2, 4, 8, 16, 32, 64, 120, 120, 120], abs=0.05)
    case.now_s += LONGEST_PAUSE_S + 1.0  # it has run for a long time
    case.worker.failed(case.worker.process, 'it has ended')
    assert case.revived_after(PAUSE_S) == pytest.approx(PAUSE_S, abs=0.05)


@pytest.mark.parametrize('first', [OSError('no memory'), Process(ready=None)])
def test_failed_start_is_a_fault_and_is_retried(case, first):
    case.next = first
    case.worker.start(), case.worker.wait()
    assert case.worker.process is None and case.worker.fault
    assert isinstance(first, OSError) or first.closed
    case.next = Process()
    case.revived_after(PAUSE_S)
    case.worker.revive()
    assert case.worker.process is case.made[-1] and case.worker.fault == ''


def test_process_that_never_becomes_ready_is_abandoned(case):
    case.worker.start(), case.worker.wait()
    case.worker.failed(case.made[0], 'it has ended')
    case.next = stuck = Process(ready=False)
    case.revived_after(PAUSE_S)
    case.now_s += 31.0
    case.worker.revive()
    assert stuck.closed and 'not ready in 30 s' in case.worker.fault


def test_failure_of_a_former_process_does_not_close_the_present_one(case):
    case.worker.start(), case.worker.wait()
    old = case.made[0]
    case.worker.close()
    case.worker.start(), case.worker.wait()
    case.worker.failed(old, 'it has ended')
    assert case.worker.process is case.made[1] and not case.made[1].closed
    assert case.worker.fault == ''


def test_nothing_is_started_after_closing_or_where_disabled(case):
    for _ in range(2):
        case.now_s += 1000.0
        case.worker.revive()
        assert case.worker.process is None
        case.worker.close()
    assert case.made == []
