# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What is skipped when the machine does not keep up, and what is not."""
from __future__ import annotations

import threading

import pytest
from stereo_speed.nodes.pair_queue import CALM_S, PairQueue, RECOVER_S
from stereo_speed.pipeline.pipeline import Hurry


class Clock:
    """Steady time that passes when it is told to."""

    def __init__(self):
        self.s = 0.0

    def __call__(self):
        return self.s


def served(period_s, work_s, pairs, most_wait_s=1.0):
    """Run a stream against a worker; return the pairs served, their delays, and how many not."""
    clock = Clock()
    queue = PairQueue(most_wait_s, 1000, clock)
    out, delays, skipped, coming, free_s = [], [], 0, 0, 0.0
    while coming < pairs or len(queue):
        if coming < pairs and (coming * period_s <= free_s or not len(queue)):
            clock.s = coming * period_s
            queue.put((clock.s, coming))
            coming += 1
            continue
        clock.s = free_s = max(free_s, clock.s)
        came_s, number = queue.take(0.0)
        out.append(number)
        delays.append(free_s + work_s - came_s)
        free_s += work_s
        skipped += queue.pop_skipped()
    return out, delays, skipped


def test_who_keeps_up_serves_all():
    out, delays, skipped = served(0.033, 0.03, 300)
    assert out == list(range(300)) and skipped == 0 and max(delays) < 0.07


def test_a_short_delay_is_made_good():
    clock = Clock()
    queue = PairQueue(1.0, 100, clock)
    for k in range(20):
        clock.s = 0.033 * k
        queue.put(k)
    assert [queue.take(0.0) for _ in range(20)] == list(range(20))
    assert not queue.overloaded and queue.pop_skipped() == 0


@pytest.mark.parametrize('work_s', [0.05, 0.1, 0.3])
def test_overload_serves_the_newest_and_counts_the_others(work_s):
    out, delays, skipped = served(0.033, work_s, 1500)
    assert out == sorted(out) and len(out) + skipped == 1500
    assert max(delays) < 1.0 + 2 * work_s  # once, before it is noticed
    assert sorted(delays)[int(0.9 * len(delays))] < 2 * work_s + 0.04  # afterwards the newest
    assert out[-1] == 1499


def test_after_the_overload_nothing_is_skipped_again():
    clock = Clock()
    queue = PairQueue(0.5, 100, clock)
    queue.put(0)
    queue.put(1)
    clock.s = 1.0
    assert queue.take(0.0) == 1 and queue.overloaded and queue.pop_skipped() == 1
    clock.s += RECOVER_S + 0.1
    queue.put(2)
    queue.put(3)
    assert [queue.take(0.0), queue.take(0.0)] == [2, 3] and not queue.overloaded


def waits(queue, clock, wait_s):
    """Serve a pair that has waited; return how it is hurried."""
    queue.put('pair')
    clock.s += wait_s
    queue.take(0.0)
    return queue.hurry


def test_pairs_that_wait_are_hurried_once_one_has_waited_for_long():
    clock = Clock()
    queue = PairQueue(2.0, 100, clock)
    assert [waits(queue, clock, s) for s in (0.0, 0.05, 0.19)] == [Hurry.NO] * 3
    assert [waits(queue, clock, s) for s in (0.21, 0.0, 0.05, 0.0)] == [
        Hurry.MUCH, Hurry.SOME, Hurry.MUCH, Hurry.SOME]
    assert queue.pop_skipped() == 0 and not queue.overloaded


def test_after_a_minute_without_a_pair_that_waits_none_is_hurried():
    clock = Clock()
    queue = PairQueue(2.0, 100, clock)
    waits(queue, clock, 0.3)
    for _ in range(int(CALM_S / 0.5) - 1):
        clock.s += 0.5
        assert waits(queue, clock, 0.0) is Hurry.SOME
    clock.s += 1.0
    assert waits(queue, clock, 0.0) is Hurry.NO
    assert waits(queue, clock, 0.05) is Hurry.NO


def test_no_more_than_so_many_wait():
    queue = PairQueue(60.0, 3, Clock())
    for k in range(5):
        queue.put(k)
    assert queue.take(0.0) == 4 and queue.pop_skipped() == 4


def test_who_waits_is_woken_when_nothing_more_comes():
    queue = PairQueue(1.0, 3)
    threading.Timer(0.05, queue.close).start()
    assert queue.take(10.0) is None
