# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A listener that knows when each pair was sent, and so the delay of its results."""
from __future__ import annotations

import time
from typing import Optional

from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

from .common import RELIABLE, stamp_ns
from .graph_listener import GraphListener

_KEPT_NS = 10 * 10**9  # time for which results of a pair may still arrive
_CLOCKS = 1000  # queue of clocks: none may be lost where this process has to wait for a core


class DelayListener(GraphListener):
    """
    Takes the arrival of the ``/clock`` that a replay sends before each image for its sending time.

    :param name: name of the node.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._sent_s: dict[int, float] = {}
        self.node.create_subscription(Clock, '/clock', self._clock, _CLOCKS)

    def _clock(self, msg: Clock) -> None:
        self._sent_s.setdefault(stamp_ns(msg.clock), time.monotonic())

    def delay_s(self, ns: int) -> Optional[float]:
        """Return the time since the pair of a stamp was sent, s; None where that is unknown."""
        sent_s = self._sent_s.get(ns)
        return None if sent_s is None else time.monotonic() - sent_s

    def forget_before(self, ns: int) -> None:
        """Drop pairs that are much older than one of this stamp."""
        self._sent_s = {sent_ns: at_s for sent_ns, at_s in self._sent_s.items()
                        if sent_ns > ns - _KEPT_NS}


class AnswerListener(DelayListener):
    """Subscribes to the answers of ``pairing_peer_node``."""

    def __init__(self) -> None:
        super().__init__('answer_listener')
        self.pairs_ns: list[int] = []
        self.delays_s: list[float] = []  # times from sending a pair to its answer
        self.node.create_subscription(Header, '/answers', self._answer, RELIABLE)

    def _answer(self, msg: Header) -> None:
        ns = stamp_ns(msg.stamp)
        self.pairs_ns.append(ns)
        delay_s = self.delay_s(ns)
        if delay_s is not None:
            self.delays_s.append(delay_s)
        self.forget_before(ns)
