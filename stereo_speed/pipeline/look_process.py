# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The process that checks the rig, at lower priority than the pairs that are measured.

Pairs are copied one by one into shared memory as they are gathered: sending all of them at once
through a pipe delayed the readings of that moment.
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

_TURN_S = 5.0  # time-out of the pipe, whose messages are small


class LookProcessError(Exception):
    """A look at the rig has failed."""


@dataclass(frozen=True, eq=False)
class Look:
    """The arguments of ``look_at_rig``, with images in shared memory."""

    used: Stance
    pairs: Sequence[SharedPair]
    config: SiteConfig
    followed: Optional[RigMotion]
    suspected: Optional[Stance]


class LookProcess(HelperProcess):
    """
    The process, for one look; see the module's docstring.

    :param patience: niceness relative to this process.  Of a fully used core, 10 takes a tenth
        and 15 a thirtieth.
    """

    def __init__(self, patience: int) -> None:
        super().__init__('stereo_speed.pipeline.look_process', _TURN_S, patience)
        self._pairs: list[SharedPair] = []

    def lay(self, pair: StereoPair) -> None:
        """Copy a pair into the shared memory, for the look that follows."""
        begin = self._pairs[-1].end if self._pairs else 0
        shared = SharedPair.of(pair, begin)
        shared.lay(pair, self.memory(shared.end))
        self._pairs.append(shared)

    def look(self, used: Stance, config: SiteConfig, followed: Optional[RigMotion],
             suspected: Optional[Stance]) -> None:
        """
        Start ``look_at_rig`` on the pairs so far; only once the process is ready.

        :raises OSError: the process has ended.
        """
        self.send(Look(used, self._pairs, config, followed, suspected))

    def found(self) -> Optional[RigState]:
        """
        Return the result of the look; None while it is under way.

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
    """Return the result of a look, or its error as text."""
    try:
        return look_at_rig(look.used, [shared.pair(memory) for shared in look.pairs],
                           look.config, look.followed, look.suspected)
    except Exception as error:
        return repr(error)


def main(pipe_fd: int, memory_fd: int) -> None:
    """Answer requests that come through a pipe, until it is closed."""
    leave_ending_to_parent()
    cv2.setNumThreads(1)  # leaves the other cores to measuring
    pipe: Connection[Any, Any] = Connection(pipe_fd)
    try:
        pipe.send('ready')
        while True:
            look = pipe.recv()
            pipe.send(_answer(look, mmap(memory_fd, 0, prot=PROT_READ)))
    except (EOFError, OSError):  # the parent has ended
        pass


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
