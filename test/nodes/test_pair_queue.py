# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs that are skipped when the machine does not keep up, and pairs that are not."""
from __future__ import annotations

import threading
from weakref import ref

import pytest
from stereo_speed.nodes.pair_queue import PairQueue, RECOVER_S


class Clock:
    """A monotonic clock that a test advances."""

    def __init__(self):
        self.s = 0.0

    def __call__(self):
        return self.s


def served(period_s, work_s, pairs, most_wait_s=1.0):
    """Run a stream against a worker; return served pairs, their delays, and the number skipped."""
    clock = Clock()
    queue = PairQueue(most_wait_s, 1000, clock)
    out, delays, skipped, coming, free_s = [], [], 0, 0, 0.0
    while coming < pairs or len(queue):
        if coming < pairs and (coming * period_s <= free_s or not len(queue)):
            clock.s = coming * period_s
            queue.put((clock.s, coming), coming)
            coming += 1
            continue
        clock.s = free_s = max(free_s, clock.s)
        came_s, number = queue.take(0.0)
        out.append(number)
        delays.append(free_s + work_s - came_s)
        free_s += work_s
        skipped += len(queue.skipped_ns)
    return out, delays, skipped


def test_fast_worker_serves_all():
    out, delays, skipped = served(0.033, 0.03, 300)
    assert out == list(range(300)) and skipped == 0 and max(delays) < 0.07


def test_short_delay_is_caught_up():
    clock = Clock()
    queue = PairQueue(1.0, 100, clock)
    for k in range(20):
        clock.s = 0.033 * k
        queue.put(k, k)
    assert [queue.take(0.0) for _ in range(20)] == list(range(20))
    assert not queue.overloaded and queue.skipped_ns == []


@pytest.mark.parametrize('work_s', [0.05, 0.1, 0.3])
def test_overload_serves_the_newest_and_counts_the_others(work_s):
    out, delays, skipped = served(0.033, work_s, 1500)
    assert out == sorted(out) and len(out) + skipped == 1500
    assert max(delays) < 1.0 + 2 * work_s  # once, before it is noticed
    assert sorted(delays)[int(0.9 * len(delays))] < 2 * work_s + 0.04  # afterwards the newest
    assert out[-1] == 1499


def test_nothing_is_skipped_after_the_overload():
    clock = Clock()
    queue = PairQueue(0.5, 100, clock)
    queue.put(0, 0)
    queue.put(1, 1)
    clock.s = 1.0
    assert queue.take(0.0) == 1 and queue.overloaded and queue.skipped_ns == [0]
    clock.s += RECOVER_S + 0.1
    queue.put(2, 2)
    queue.put(3, 3)
    assert [queue.take(0.0), queue.take(0.0)] == [2, 3] and not queue.overloaded


def hurried_stream(work_s, lasts_s, most_wait_s=2.0, starts_s=0.0, period_s=0.033):
    """
    Serve a stream; return when each pair was served, how late, and whether it was hurried.

    :param work_s: time that a pair takes, from when it is served and whether it is hurried.
    :param starts_s: time until measuring is ready for the first pair.
    """
    clock, out, coming, free_s = Clock(), [], 0, 0.0
    queue = PairQueue(most_wait_s, 1000, clock)
    while free_s < lasts_s:
        while coming * period_s <= free_s or not len(queue):
            clock.s = coming * period_s
            queue.put(coming * period_s, coming)
            coming += 1
        clock.s = free_s = max(free_s, clock.s)
        came_s = queue.take(0.0)
        out.append((clock.s, clock.s - came_s, queue.hurried))
        if len(out) == 1 and starts_s:
            free_s = clock.s = free_s + starts_s
            queue.ready()
        free_s += work_s(clock.s, queue.hurried)
    return out, queue


@pytest.mark.parametrize('period_s', [0.033, 0.2])
def test_pair_that_waits_most_of_an_interval_is_hurried(period_s):
    """Every tenth pair takes 90 % more time than there is."""
    calls = iter(range(10**6))
    out, _ = hurried_stream(
        lambda s, hurried: period_s * (1.9 if next(calls) % 10 == 0 else 0.5), 300 * period_s,
        period_s=period_s)
    assert [waited > 0.6 * period_s for _, waited, _ in out] == [hurried for *_, hurried in out]
    assert 0.05 < sum(hurried for *_, hurried in out) / len(out) < 0.2


def test_fast_worker_hurries_no_pair_despite_jitter():
    clock = Clock()
    queue = PairQueue(2.0, 100, clock)
    for k in range(100):
        clock.s = 0.033 * k + 0.015 * (k % 2)  # two arrive near to each other
        queue.put(k, k)
        clock.s += 0.01
        assert queue.take(0.0) == k and not queue.hurried


def test_worker_that_keeps_up_only_when_hurried_serves_all_soon():
    out, queue = hurried_stream(lambda s, hurried: 0.012 if hurried else 0.045, 60.0)
    came_s = [at_s - waited for at_s, waited, _ in out]
    assert came_s == pytest.approx([0.033 * k for k in range(len(out))])  # all of them
    assert max(waited for _, waited, _ in out) < 0.05
    assert 0.2 < sum(hurried for *_, hurried in out) / len(out) < 0.6


def test_after_a_slow_start_only_long_waiting_pairs_are_hurried():
    out, _ = hurried_stream(lambda s, hurried: 0.015, 10.0, starts_s=0.7)
    assert not [s for s, _, hurried in out if hurried and s > 2.5]


def test_pair_that_waited_only_for_the_start_is_not_hurried():
    clock = Clock()
    queue = PairQueue(2.0, 100, clock)
    queue.put('pair', 0)
    clock.s = 1.5
    queue.ready()
    clock.s = 1.51
    assert queue.take(0.0) == 'pair' and not queue.hurried


def test_skipping_worker_hurries_until_some_time_afterwards():
    out, _ = hurried_stream(lambda s, hurried: 0.1 if s < 60.0 else 0.01, 100.0, 0.5)
    late = [s for s, _, hurried in out if hurried]
    assert late[0] < 1.0 and [s for s, *_ in out if late[0] < s < 60.0] == [
        s for s in late if late[0] < s < 60.0]
    assert 60.0 < late[-1] < 60.0 + RECOVER_S + 1.0


def test_hurrying_can_be_disabled():
    clock = Clock()
    queue = PairQueue(2.0, 100, clock, hurry=False)
    for wait_s in (0.3, 1.0, 3.0):
        queue.put('pair', 0)
        clock.s += wait_s
        assert queue.take(0.0) == 'pair' and not queue.hurried


def test_number_of_waiting_pairs_is_limited():
    queue = PairQueue(60.0, 3, Clock())
    for k in range(5):
        queue.put(k, k)
    assert queue.take(0.0) == 4 and queue.skipped_ns == [0, 1, 2, 3]


def test_waiting_reader_is_woken_at_the_end_of_the_stream():
    queue = PairQueue(1.0, 3)
    threading.Timer(0.05, queue.close).start()
    assert queue.take(10.0) is None


def test_skipped_pair_is_not_kept():
    """Its images would fill the memory while the measuring thread is busy."""
    queue, pair = PairQueue(60.0, 1, Clock()), Clock()
    gone = ref(pair)
    queue.put(pair, 0)
    queue.put(None, 1)
    del pair
    assert gone() is None
