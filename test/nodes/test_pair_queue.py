# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What is skipped when the machine does not keep up, and what is not."""
from __future__ import annotations

import threading

import pytest
from stereo_speed.nodes.pair_queue import CALM_S, MOST_CALM_S, PairQueue, RECOVER_S
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


def hurried_stream(work_s, lasts_s, most_wait_s=2.0, starts_s=0.0, period_s=0.033):
    """
    Serve a stream; return when each pair was served, how it was hurried, and the queue.

    :param work_s: gives the time that a pair takes, from when it is served and how it is hurried.
    :param starts_s: what the first pair takes until measuring is ready.
    """
    clock, out, coming, free_s = Clock(), [], 0, 0.0
    queue = PairQueue(most_wait_s, 1000, clock)
    while free_s < lasts_s:
        while coming * period_s <= free_s or not len(queue):
            clock.s = coming * period_s
            queue.put(coming)
            coming += 1
        clock.s = free_s = max(free_s, clock.s)
        queue.take(0.0)
        out.append((clock.s, queue.hurry))
        if len(out) == 1 and starts_s:
            free_s = clock.s = free_s + starts_s
            queue.ready()
        free_s += work_s(clock.s, queue.hurry)
    return out, queue


def hurried_s(out):
    """Return the times at which pairs were hurried."""
    return [s for s, hurry in out if hurry is not Hurry.NO]


def test_a_start_that_takes_long_hurries_for_a_few_seconds_at_most():
    out, queue = hurried_stream(lambda s, hurry: 0.015, 60.0, starts_s=0.7)
    assert all(s < 4.0 for s in hurried_s(out)) and queue.hurrying_s == 0.0


def test_what_waited_for_the_start_alone_is_not_hurried():
    clock = Clock()
    queue = PairQueue(2.0, 100, clock)
    queue.put('pair')
    clock.s = 1.5
    queue.ready()
    clock.s = 1.6
    assert queue.take(0.0) == 'pair' and queue.hurry is Hurry.NO


@pytest.mark.parametrize('stall_s', [0.05, 0.12])
def test_single_stalls_do_not_prolong_it(stall_s):
    """Once it stands for 0.3 s; from then on, for a moment every 1 s, less than a long wait."""
    stalls = [10.0, *range(11, 120)]

    def work_s(s, hurry):
        if stalls and s >= stalls[0]:
            stalls.pop(0)
            return 0.3 if s < 11.0 else stall_s
        return 0.015
    out, _ = hurried_stream(work_s, 120.0)
    assert hurried_s(out) and all(10.0 < s < 10.3 + CALM_S + 0.6 for s in hurried_s(out))


def test_who_keeps_up_only_in_haste_hurries_most_of_the_time():
    out, queue = hurried_stream(lambda s, hurry: 0.04 if hurry is Hurry.NO else 0.02, 600.0)
    late = [hurry is not Hurry.NO for s, hurry in out if s > 120.0]
    assert sum(late) >= 0.8 * len(late)
    assert queue.pop_skipped() == 0


def test_when_the_traffic_is_over_so_is_the_haste_and_the_next_one_begins_short():
    busy_s = ((0.0, 300.0), (500.0, 510.0))

    def work_s(s, hurry):
        busy = any(begin <= s < end for begin, end in busy_s)
        return 0.02 if hurry is not Hurry.NO or not busy else 0.04
    out, _ = hurried_stream(work_s, 600.0)
    hurried = hurried_s(out)
    assert not [s for s in hurried if 300.0 + MOST_CALM_S + 1.0 < s < 500.0]
    second = [s for s in hurried if s > 500.0]
    assert second and max(second) < 520.0


def test_it_is_told_for_how_long_pairs_have_been_hurried():
    clock = Clock()
    queue = PairQueue(2.0, 100, clock)
    waits(queue, clock, 0.3)
    assert queue.hurrying_s == 0.0
    for _ in range(4):
        clock.s += 1.0
        waits(queue, clock, 0.15)
    assert queue.hurrying_s == pytest.approx(4.6)
    clock.s += CALM_S + 0.1  # no pair comes any more
    assert queue.hurrying_s == 0.0


@pytest.mark.parametrize('work_s', [0.05, 0.1])
def test_who_skips_hurries_and_does_until_some_time_after(work_s):
    out, _ = hurried_stream(lambda s, hurry: work_s if s < 60.0 else 0.01, 100.0, 0.5)
    hurried, first_s = hurried_s(out), hurried_s(out)[0]
    assert first_s < 1.0 and [s for s, _ in out if first_s < s < 60.0] == [
        s for s in hurried if first_s < s < 60.0]
    assert 60.0 + RECOVER_S < hurried[-1] < 60.0 + RECOVER_S + MOST_CALM_S


@pytest.mark.parametrize('most_wait_s', [0.0, 0.2])
def test_however_little_pairs_may_wait_jitter_does_not_hurry(most_wait_s):
    clock = Clock()
    queue = PairQueue(most_wait_s, 100, clock)
    assert [waits(queue, clock, s) for s in (0.02, 0.0, 0.09)] == [Hurry.NO] * 3
    assert waits(queue, clock, 0.11) is Hurry.MUCH


def test_who_wants_no_haste_has_none():
    clock = Clock()
    queue = PairQueue(2.0, 100, clock, hurry=False)
    assert [waits(queue, clock, s) for s in (0.3, 1.0, 3.0)] == [Hurry.NO] * 3
    assert queue.hurrying_s == 0.0


def test_no_more_than_so_many_wait():
    queue = PairQueue(60.0, 3, Clock())
    for k in range(5):
        queue.put(k)
    assert queue.take(0.0) == 4 and queue.pop_skipped() == 4


def test_who_waits_is_woken_when_nothing_more_comes():
    queue = PairQueue(1.0, 3)
    threading.Timer(0.05, queue.close).start()
    assert queue.take(10.0) is None
