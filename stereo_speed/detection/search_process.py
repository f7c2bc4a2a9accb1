# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The process in which a detector searches beside the tracks; see ``beside``."""
from __future__ import annotations

from dataclasses import replace
from mmap import mmap, PROT_READ
from multiprocessing.connection import Connection
import os
import sys
from typing import Any, Optional

import cv2

from .beside import Begin, Forget, Found, Request, Search
from .detector import Look, PlaneSweepDetector
from .spacing import Held
from ..core.compiled import warm_up
from ..core.helper_process import leave_ending_to_parent
from ..core.records import StereoPair


class Searcher:
    """
    Handles the requests of a :class:`.beside.DetectorBeside`.

    :param memory_fd: file descriptor of the shared memory with the images of pairs.
    """

    def __init__(self, memory_fd: int) -> None:
        self._fd = memory_fd
        self._memory: Optional[mmap] = None
        self._detector: Optional[PlaneSweepDetector] = None
        self._look: Optional[Look] = None

    def do(self, request: Request) -> Optional[Found]:
        """
        Handle a request; return its answer, or None where it has none.

        :raises ValueError: there was no request to begin.
        """
        if isinstance(request, Begin):
            self._detector = PlaneSweepDetector(request.rig, request.lanes, request.config)
            self._detector.recall(request.memory, request.pairs)
            return None
        if self._detector is None:
            raise ValueError('found a request without a site, wanted the site first')
        if isinstance(request, Forget):
            self._detector.reset()
            return None
        if isinstance(request, Search):
            self._detector.pass_over(request.last_ns, request.last_index)
            self._look = self._detector.look(self._pair(request))
        return _found(self._detector, self._look, self._detector.held(request.tracked))

    def _pair(self, request: Search) -> StereoPair:
        """Return the pair in the shared memory; its images are valid until the next request."""
        size = os.fstat(self._fd).st_size
        if self._memory is None or len(self._memory) != size:
            self._memory = mmap(self._fd, size, prot=PROT_READ)
        return request.pair.pair(self._memory)


def _found(detector: PlaneSweepDetector, look: Optional[Look], held: Held) -> Found:
    """Search, and return an answer that refers to earlier pairs by their stamps."""
    bare, since_ns = [], []
    for one in detector.detections(look, held):
        earlier = one.earlier
        since_ns.append(() if earlier is None else tuple(p.stamp_ns for p in earlier.pairs))
        bare.append(one if earlier is None else replace(one, earlier=replace(earlier, pairs=())))
    return Found(bare, since_ns, held.asked, detector.memory)


def main(pipe_fd: int, memory_fd: int) -> None:
    """Handle requests that come through a pipe, until it is closed."""
    leave_ending_to_parent()
    cv2.setNumThreads(1)  # leaves the other cores to the tracks
    warm_up()
    searcher = Searcher(memory_fd)
    pipe: Connection[Any, Any] = Connection(pipe_fd)
    try:
        pipe.send('ready')
        while True:
            answer = searcher.do(pipe.recv())
            if answer is not None:
                pipe.send(answer)
    except (EOFError, OSError):  # the parent has ended
        pass


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
