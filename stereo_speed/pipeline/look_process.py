# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The process in which the rig is looked at, beside the pairs that are measured, which go first.

Its pairs come one by one into memory that it shares, spread over a while as they are gathered:
all of them at once, through a pipe, kept the readings of that moment waiting.
"""
from __future__ import annotations

from dataclasses import dataclass
from mmap import mmap, PROT_READ
from multiprocessing.connection import Connection
import sys
from typing import Any, Optional, Sequence, Union

import cv2

from .config import SiteConfig
from .rig_look import look_at_rig
from ..core.helper_process import HelperProcess, leave_ending_to_parent
from ..core.records import RigMotion, StereoPair
from ..core.shared_pair import SharedPair
from ..site.refine.rig_state import RigState, Stance

_TURN_S = 5.0  # that the pipe may stand still: what goes through it is small
# With the processor: what measures goes first, and where that has all of it a tenth of a core is
# left; with 15 it was a thirtieth.
_PATIENCE = 10


class LookProcessError(Exception):
    """A look came to nothing."""


@dataclass(frozen=True, eq=False)
class Look:
    """What ``look_at_rig`` takes, but for the images."""

    used: Stance
    pairs: Sequence[SharedPair]
    config: SiteConfig
    followed: Optional[RigMotion]
    suspected: Optional[Stance]


class LookProcess(HelperProcess):
    """
    The process, for one look; see the module's docstring.

    :param patience: with the processor.
    """

    def __init__(self, patience: int = _PATIENCE) -> None:
        super().__init__('stereo_speed.pipeline.look_process', _TURN_S, patience)
        self._pairs: list[SharedPair] = []

    def lay(self, pair: StereoPair) -> None:
        """Lay a pair into the shared memory, for the look that will be asked for."""
        begin = self._pairs[-1].end if self._pairs else 0
        shared = SharedPair.of(pair, begin)
        shared.lay(pair, self.memory(shared.end))
        self._pairs.append(shared)

    def look(self, used: Stance, config: SiteConfig, followed: Optional[RigMotion],
             suspected: Optional[Stance]) -> None:
        """
        Have the pairs so far looked at, as ``look_at_rig`` does; not before it is ready.

        :raises OSError: the process has ended.
        """
        self.send(Look(used, self._pairs, config, followed, suspected))

    def found(self) -> Optional[RigState]:
        """
        Return what the look has found; None while it is under way.

        :raises OSError: the process has ended.
        :raises LookProcessError: the look has failed.
        """
        if not self.has_answer():
            return None
        answer: Union[RigState, str] = self.received()
        if isinstance(answer, str):
            raise LookProcessError(answer)
        return answer


def _answer(look: Look, memory: mmap) -> Union[RigState, str]:
    """Return what a look finds, or why it fails, whatever the reason."""
    try:
        return look_at_rig(look.used, [shared.pair(memory) for shared in look.pairs],
                           look.config, look.followed, look.suspected)
    except Exception as error:
        return repr(error)


def main(pipe_fd: int, memory_fd: int) -> None:
    """Look at what comes through a pipe, until it is closed."""
    leave_ending_to_parent()
    cv2.setNumThreads(1)  # what measures has the other cores
    pipe: Connection[Any, Any] = Connection(pipe_fd)
    try:
        pipe.send('ready')
        while True:
            look = pipe.recv()
            pipe.send(_answer(look, mmap(memory_fd, 0, prot=PROT_READ)))
    except (EOFError, OSError):  # who started this is gone
        pass


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
