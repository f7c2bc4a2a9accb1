# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The helper processes of a measuring node, as forks of it.

A fork has the node's libraries, which take a second of a core to load, and shares their memory.
A node can be forked only while it has a single thread, which is before ROS is imported.  So the
forks are made before the parameters tell whether they are needed.
"""
from __future__ import annotations

import gc
from importlib import import_module
from typing import Optional

from ..core.helper_process import can_fork
from ..detection.beside import SearchProcess
from ..pipeline.pass_process import PassProcess

# Imported before the forks are made, because node and forks need them.
_PRELOADED = ('stereo_speed.detection.search_process', 'stereo_speed.pipeline.assembly',
              'stereo_speed.tracking.constrained')


class Helpers:
    """
    The forks, each of which is handed out once; later requests start new processes.

    Without a call of ``fork``, or where this process cannot be forked, all processes are new.
    """

    def __init__(self) -> None:
        self._search: Optional[SearchProcess] = None
        self._pass: Optional[PassProcess] = None

    def fork(self) -> None:
        """Make the forks."""
        if not can_fork():
            return
        for module in _PRELOADED:
            import_module(module)
        gc.freeze()  # otherwise a garbage collection in a fork would copy the shared memory
        try:
            self._search = SearchProcess(fork=True)
            self._pass = PassProcess(fork=True)
        except OSError:  # the node reports the error when it starts a process itself
            pass

    def search_process(self) -> SearchProcess:
        """
        Return the fork that searches for vehicles, or a new process.

        :raises OSError: it cannot be started.
        """
        process, self._search = self._search, None
        return SearchProcess() if process is None else process

    def pass_process(self) -> PassProcess:
        """
        Return the fork that measures passes, or a new process.

        :raises OSError: it cannot be started.
        """
        process, self._pass = self._pass, None
        return PassProcess() if process is None else process

    def close(self) -> None:
        """End the forks that were not handed out."""
        for process in (self._search, self._pass):
            if process is not None:
                process.close(0.0)
        self._search = self._pass = None
