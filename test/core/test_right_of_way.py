# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Threads that give way stop when they are asked to, and no longer than needed."""
from __future__ import annotations

import threading

import pytest
from stereo_speed.core.right_of_way import give_way, RightOfWay

_LONG_S = 30.0  # more than a busy machine takes


@pytest.fixture
def passing():
    """Return a function that starts a thread which gives way once, and returns its event."""
    threads = []

    def begin(way):
        arrived, passed = threading.Event(), threading.Event()

        def run():
            way.give()
            arrived.set()
            give_way()
            passed.set()
        threads.append(threading.Thread(target=run))
        threads[-1].start()
        assert arrived.wait(_LONG_S)
        return passed
    yield begin
    for thread in threads:
        thread.join(_LONG_S)
        assert not thread.is_alive()


def test_yielding_thread_waits_while_held_and_then_continues(passing):
    way = RightOfWay(most_s=_LONG_S)
    with way.held():
        passed = passing(way)
        assert not passed.wait(0.05)
    assert passed.wait(_LONG_S)


def test_yielding_thread_is_held_for_a_limited_time(passing):
    way = RightOfWay(most_s=0.01)
    with way.held():
        assert passing(way).wait(_LONG_S)


def test_thread_not_asked_to_yield_does_not_wait():
    with RightOfWay(most_s=_LONG_S).held():
        give_way()
