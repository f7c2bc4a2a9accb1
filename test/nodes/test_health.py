# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Levels rise with a fault and fall after it; logs stay short; missing items are counted."""
from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from stereo_speed.nodes.health import (
    Arrivals, ERROR, Look, Neighbours, OK, Refusals, Repeats, StampGaps, State, Tally, WARN,
    WINDOW_S)

PERIOD_NS = 33_333_333


class Clock:
    """A monotonic clock that a test advances."""

    def __init__(self):
        self.s = 100.0

    def __call__(self):
        return self.s


@pytest.fixture()
def clock():
    return Clock()


def level_of(tell, *words):
    state = State('fine')
    tell(state, *words)
    return state.level


def test_tally_forgets_old_events_and_gives_the_rate(clock):
    tally = Tally(clock)
    for _ in range(20):
        clock.s += 0.1
        tally.add()
    assert (tally.recent, tally.total) == (20, 20)
    assert tally.rate_hz == pytest.approx(10.0)
    clock.s += WINDOW_S + 0.1
    assert (tally.recent, tally.total, tally.rate_hz) == (0, 20, 0.0)


def test_tally_that_is_never_read_stays_small(clock):
    """Otherwise it would grow with every image."""
    tally = Tally(clock)
    for _ in range(10_000):
        clock.s += 0.1
        tally.add(2)
    assert tally.total == 20_000
    assert len(tally._events) <= WINDOW_S / 0.1 + 1


def test_tally_can_be_counted_and_read_in_different_threads():
    """Without a lock the reader would meet a queue that changes during iteration."""
    tally = Tally()

    def count():
        for _ in range(20_000):
            tally.add()
    with ThreadPoolExecutor(2) as threads:
        counting = [threads.submit(count) for _ in range(2)]
        while not all(one.done() for one in counting):
            assert 0 <= tally.recent <= tally.total
            assert tally.rate_hz >= 0.0
        for one in counting:
            one.result()
    assert tally.total == 40_000


def test_refusals_are_logged_once_a_second_per_topic_and_expire(clock):
    lines = []
    refusals = Refusals(lines.append, clock)
    for _ in range(24):
        refusals.add('left', 'found a, wanted b')
        clock.s += 0.125
    refusals.add('right', 'found c, wanted d')
    assert len(lines) == 4
    assert lines[0] == 'refused: found a, wanted b'
    assert lines[1] == 'refused: found a, wanted b (7 more since the last line)'
    assert level_of(refusals.tell) == WARN
    clock.s += WINDOW_S + 0.1
    state = State('fine')
    refusals.tell(state)
    assert (state.level, state.message, state.values['refused']) == (OK, 'fine', 25)


def test_silence_is_an_error_until_a_message_comes(clock):
    arrivals = Arrivals(clock)
    assert level_of(arrivals.tell, 'image', 'image') == WARN  # none yet
    for _ in range(3):
        clock.s += 0.1
        arrivals.add()
    assert level_of(arrivals.tell, 'image', 'image') == OK
    clock.s += 2.1
    assert level_of(arrivals.tell, 'image', 'image') == ERROR
    arrivals.add()
    clock.s += 0.1
    arrivals.add()
    assert level_of(arrivals.tell, 'image', 'image') == OK


def test_slow_stream_is_not_silent(clock):
    arrivals = Arrivals(clock)
    for _ in range(3):
        clock.s += 3.0
        arrivals.add()
    clock.s += 10.0
    assert not arrivals.silent
    clock.s += 6.0
    assert arrivals.silent


@pytest.mark.parametrize('share', [0.0, 0.1, 0.3, 0.5])
def test_lost_images_are_counted_by_their_stamps(share):
    rng, gaps = np.random.default_rng(1), StampGaps()
    stamps = PERIOD_NS * np.arange(600)
    kept = np.flatnonzero(rng.random(600) >= share)
    counted = sum(gaps.add(int(ns)) for ns in stamps[kept])
    true = kept[-1] - kept[0] + 1 - len(kept)
    assert counted == pytest.approx(true, abs=0.05 * true + 0.5)


def test_uneven_intervals_do_not_count_as_lost_images():
    gaps = StampGaps()
    stamps = np.cumsum(np.random.default_rng(2).uniform(0.9, 1.3, 300)) * PERIOD_NS
    assert sum(gaps.add(int(ns)) for ns in stamps) == 0


def test_setting_the_clock_does_not_count_as_lost_images():
    gaps = StampGaps()
    stamps = PERIOD_NS * np.arange(100)
    stamps[50:] += 3_600_000_000_000
    assert sum(gaps.add(int(ns)) for ns in stamps) == 0


def picture(seed, mean=100.0):
    noise = np.random.default_rng(seed).normal(mean, 30.0, (96, 128))
    return noise.clip(0, 255).astype(np.uint8)


def test_frozen_images_are_reported_and_expire(clock):
    look = Look(clock)
    for _ in range(6):
        clock.s += 0.3
        look.add(picture(0))
    assert level_of(look.tell, 'left') == ERROR
    clock.s += 0.3
    look.add(picture(1))
    assert level_of(look.tell, 'left') == OK


def test_one_different_pixel_makes_a_new_image():
    repeats, other = Repeats(), picture(0)
    assert not repeats.add(picture(0)) and repeats.add(picture(0))
    other[3, 5] ^= 1
    assert not repeats.add(other) and repeats.add(other.copy())
    assert not repeats.add(other.astype(np.uint16)) and not repeats.add(other[1:])


@pytest.mark.parametrize('changing', [1, 2])
@pytest.mark.parametrize('grey, word', [(0, 'black'), (180, 'without contrast')])
def test_blank_images_are_reported(clock, grey, word, changing):
    look = Look(clock)
    for k in range(6):
        clock.s += 0.3
        look.add(np.full((96, 128), grey, np.uint8) + np.uint8(k % changing))
    state = State('fine')
    look.tell(state, 'right')
    assert state.level == ERROR and word in state.message


def test_missing_neighbour_is_reported_late_at_the_start_and_at_once_afterwards(clock):
    there = [0]
    neighbours = Neighbours(lambda: there[0], clock)

    def level():
        return level_of(neighbours.tell, ERROR, 'nobody publishes', 'publishers')
    clock.s += 9.9
    assert level() == OK  # it may still be starting
    clock.s += 0.2
    assert level() == ERROR
    for number, wanted in ((1, OK), (0, ERROR), (2, OK)):
        there[0] = number
        assert level() == wanted


def test_neighbour_that_ends_soon_after_the_start_is_reported_at_once(clock):
    numbers = iter((1, 0))
    neighbours = Neighbours(lambda: next(numbers), clock)
    assert level_of(neighbours.tell, WARN, 'nobody subscribes', 'subscribers') == OK
    state = State('fine')
    neighbours.tell(state, WARN, 'nobody subscribes', 'subscribers')
    assert (state.level, state.message) == (WARN, 'nobody subscribes')
    assert state.values == {'subscribers': 0}
