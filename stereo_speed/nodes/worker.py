# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A helper process of a node, with its fault and its restarts."""
from __future__ import annotations

import threading
import time
from typing import Callable, Generic, Optional, TypeVar

from rclpy.impl.rcutils_logger import RcutilsLogger

from ..core.helper_process import HelperProcess

PAUSE_S, LONGEST_PAUSE_S = 2.0, 120.0  # first and longest pause before a restart; it doubles
_START_S = 30.0  # time-out of a start, which takes two seconds on an idle machine

P = TypeVar('P', bound=HelperProcess)


class Worker(Generic[P]):
    """
    Manages the process from ``start`` to ``close``; after a failure it is restarted.

    ``fault`` describes the present fault, and is empty while there is none.  One thread calls
    ``start``, ``revive`` and ``close``; others use ``process`` and call ``failed``.

    :param does: what the process does, in words that follow the name of the node.
    :param make: starts the process; may raise OSError.
    :param log: logger of the node.
    :param clock: steady time, s.
    """

    def __init__(self, does: str, make: Callable[[], P], log: RcutilsLogger,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self.fault = ''
        self._does, self._make, self._log, self._clock = does, make, log, clock
        self._process: Optional[P] = None
        self._starting: Optional[P] = None
        self._since_s, self._due_s, self._pause_s = 0.0, 0.0, PAUSE_S
        self._lock = threading.Lock()

    @property
    def process(self) -> Optional[P]:
        """Return the process; None while none is ready."""
        return self._process

    def start(self) -> None:
        """Begin to start the process."""
        self.fault, self._pause_s = '', PAUSE_S
        self._begin()

    def wait(self) -> None:
        """Wait until the process is ready, or has failed to start."""
        if self._starting is not None:
            try:
                self._starting.wait()
            except OSError as error:
                self._not_started(error)
            else:
                self._serve()

    def revive(self) -> None:
        """Advance a start that is under way, or begin one that is due; to be called regularly."""
        now_s = self._clock()
        if self._starting is None:
            if self.fault and now_s >= self._due_s:
                self._begin()
            return
        try:
            if self._starting.is_ready():
                self._serve()
            elif now_s - self._since_s > _START_S:
                raise TimeoutError(f'not ready in {_START_S:g} s')
        except OSError as error:
            self._not_started(error)

    def failed(self, process: P, why: str) -> None:
        """
        Give up a process that is no longer usable, and restart it later.

        :param process: the process; ignored if it is not the present one.
        :param why: the reason.
        """
        with self._lock:
            if process is not self._process:
                return
            self._process = None
            if self._clock() - self._since_s > LONGEST_PAUSE_S:
                self._pause_s = PAUSE_S
            self._ail(why)
        process.close(0.0)

    def close(self) -> None:
        """End the process, if there is one."""
        with self._lock:
            processes = self._process, self._starting
            self._process = self._starting = None
            self.fault = ''
        for process in processes:
            if process is not None:
                process.close()

    def _begin(self) -> None:
        self._since_s = self._clock()
        try:
            self._starting = self._make()
        except OSError as error:  # no memory, no more processes
            with self._lock:
                self._ail(str(error))

    def _serve(self) -> None:
        """Make the started process available."""
        with self._lock:
            self._process, self._starting, self._since_s = self._starting, None, self._clock()
            again, self.fault = bool(self.fault), ''
        if again:
            self._log.info(f'{self._does} in a separate process again')

    def _not_started(self, error: OSError) -> None:
        starting, self._starting = self._starting, None
        with self._lock:
            self._ail(str(error))
        if starting is not None:
            starting.close(0.0)

    def _ail(self, why: str) -> None:
        """Set and log the fault, and when the process is to be restarted."""
        self.fault = f'{self._does} without a separate process: {why}'
        self._log.error(self.fault)
        self._due_s = self._clock() + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
