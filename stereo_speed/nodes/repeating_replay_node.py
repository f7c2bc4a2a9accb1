# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``repeating_replay_node``: plays a bag repeatedly, as a camera pair that never stops.

Unlike with ``loop`` of ``replay_node``, stamps continue to rise from one round to the next.
"""
from __future__ import annotations

from functools import partial
from typing import Iterator

from .common import Parameters, run
from .replay_node import ReplayNode
from ..io.bags import BagMessage


class RepeatingReplayNode(ReplayNode):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__('repeating_replay_node')
        p = Parameters(self)
        self.rounds = p.get('rounds', 1, 'number of times that the bag is played', 1, 1_000_000)
        round_s = p.get('round_s', 10.0, 'time from a stamp to the same one in the next round [s]',
                        0.1, 86400.0)
        self.round_ns = round(round_s * 1e9)

    def messages(self) -> Iterator[BagMessage]:
        """Yield the messages of all rounds, with the stamps of their round."""
        for number in range(self.rounds):
            for message in super().messages():
                yield message._replace(stamp_ns=message.stamp_ns + number * self.round_ns)


main = partial(run, RepeatingReplayNode, spin=RepeatingReplayNode.play)

if __name__ == '__main__':
    raise SystemExit(main())
