# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The processes that work for a node that measures, as forks of it.

A fork has the libraries of the node, which take a second of a core to load, and shares their
memory.  It can be made only while the node has a single thread, which is before ROS is there; so
it is made before the parameters tell whether it is wanted.
"""
from __future__ import annotations

import gc
from importlib import import_module
from typing import Optional

from ..core.helper_process import can_fork
from ..detection.beside import SearchProcess
from ..pipeline.pass_process import PassProcess

# What measures, which the forks need too.
_SHARED = ('stereo_speed.detection.search_process', 'stereo_speed.pipeline.assembly',
           'stereo_speed.tracking.constrained')


class Helpers:
    """
    The forks, each given away once; a node that starts one anew starts a process of its own.

    Without ``fork``, and where this process cannot be forked, there are none to give away.
    """

    def __init__(self) -> None:
        self._search: Optional[SearchProcess] = None
        self._pass: Optional[PassProcess] = None

    def fork(self) -> None:
        """Make the forks."""
        if not can_fork():
            return
        for module in _SHARED:
            import_module(module)
        gc.freeze()  # or each of them would copy what it looks at for garbage
        try:
            self._search = SearchProcess(fork=True)
            self._pass = PassProcess(fork=True)
        except OSError:  # no more processes: the node will tell when it tries again
            pass

    def search_process(self) -> SearchProcess:
        """
        Return the process that searches, or a new one.

        :raises OSError: it cannot be started.
        """
        process, self._search = self._search, None
        return SearchProcess() if process is None else process

    def pass_process(self) -> PassProcess:
        """
        Return the process that measures passes, or a new one.

        :raises OSError: it cannot be started.
        """
        process, self._pass = self._pass, None
        return PassProcess() if process is None else process

    def close(self) -> None:
        """End those that nobody wanted."""
        for process in (self._search, self._pass):
            if process is not None:
                process.close(0.0)
        self._search = self._pass = None
