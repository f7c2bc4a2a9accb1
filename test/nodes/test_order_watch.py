# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Detection of swapped views: no reading before it is decided, no delay afterwards."""
from __future__ import annotations

import threading
import time

from stereo_speed.nodes.order_watch import OrderWatch

LONG_S = 30.0


class Looks:
    """Returns given answers in order, as soon as it may."""

    def __init__(self, *answers):
        self.answers, self.now_s, self.may = list(answers), 0.0, threading.Event()
        self.may.set()
        self.over, self.pairs = threading.Semaphore(0), []

    def __call__(self, rig, pair):
        assert self.may.wait(LONG_S)
        self.pairs.append(pair)
        try:
            return self.answers.pop(0)
        finally:
            self.over.release()

    def watch(self):
        return OrderWatch(self, lambda: self.now_s)


def test_first_check_is_waited_for():
    for answer, crossed in ((True, True), (False, False), (None, False)):
        watch = Looks(answer).watch()
        assert watch.take(None, 'pair') is crossed and watch.crossed is crossed
        watch.close()


def test_first_check_begun_ahead_is_waited_for_and_not_repeated():
    looks = Looks(True, False)
    watch = looks.watch()
    watch.begin(None, 'ahead'), watch.begin(None, 'again')
    assert watch.take(None, 'pair') is True and looks.pairs == ['ahead']
    watch.begin(None, 'late')
    looks.now_s = 1e3
    assert watch.take(None, 'next') is False and looks.pairs == ['ahead', 'next']
    watch.close()


def test_later_checks_are_taken_in_with_a_later_pair():
    looks = Looks(False, True)
    watch = looks.watch()
    watch.take(None, 0)
    assert looks.over.acquire(timeout=LONG_S)
    looks.now_s = 9.0
    assert watch.take(None, 1) is False and looks.pairs == [0]  # too soon for another
    looks.may.clear()
    looks.now_s = 11.0
    assert watch.take(None, 2) is False  # returned at once, whatever the check will find
    looks.may.set()
    assert looks.over.acquire(timeout=LONG_S)
    watch.close()
    end_s = time.monotonic() + LONG_S
    while not watch.take(None, 3):  # until the thread has finished
        assert time.monotonic() < end_s
    assert looks.pairs == [0, 2]


def test_each_check_is_waited_for_while_the_views_are_swapped():
    looks = Looks(True, None, False)
    watch = looks.watch()
    assert watch.take(None, 0)
    for now_s, crossed in ((0.5, True), (1.5, True), (2.6, False)):
        looks.now_s = now_s
        assert watch.take(None, now_s) is crossed
    assert looks.pairs == [0, 1.5, 2.6]
    watch.close()
