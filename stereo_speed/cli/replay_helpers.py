# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Helper processes and threads of a replay on a machine with several cores.

A thread reads and decodes pairs ahead.  Two processes take over part of the work: one runs the
detector while the tracks of the pair are updated, the other measures finished passes while the
following pairs are processed.  The output is identical to the last bit with them, without them,
and when one dies: each computes what the main process would, and is asked in order.
"""
from __future__ import annotations

import os
import sys
from types import TracebackType
from typing import Any, Mapping, Optional

from ..core.compiled import warm_up
from ..core.helper_process import can_fork
from ..core.passes import PassResult
from ..detection.beside import DetectorBeside, SearchProcess
from ..detection.detector import PlaneSweepDetector
from ..geometry.rig import StereoRig
from ..pipeline.assembly import MakeDetector
from ..pipeline.conclusions import Later, Measure
from ..pipeline.pass_process import measured_beside, PassProcess
from ..pipeline.registry import DETECTORS
from ..road.lanes import LanePath

# They save about 4 ms per pair; starting them costs < 0.1 s with fork and 4 s without.
FEWEST_PAIRS, FEWEST_WITHOUT_FORK = 60, 1500
# Switch interval of threads; the reading thread asks for the GIL about ten times per pair.
_TURN_S = 5e-4


class Helpers:
    """
    The helpers of one replay; a context manager.

    :param processes: whether to start the processes.
    :param detector: name of the detector; None where vehicles are annotated.
    :param ahead: whether pairs are read ahead.
    """

    def __init__(self, processes: bool, detector: Optional[str], *, ahead: bool = True) -> None:
        self.ahead = ahead
        self._search: Optional[SearchProcess] = None
        self._pass: Optional[PassProcess] = None
        self._search_ready = self._pass_ready = False
        self.later: Optional[Later] = None  # measures passes; None: the pipeline does
        self.detect: Optional[MakeDetector] = None  # makes its detector; None: the usual one
        if not processes:
            return
        try:
            warm_up()  # forks inherit the compiled kernels
            self._pass = PassProcess(fork=True)
            self.later = Later(self._measured)
            if detector is not None and DETECTORS.load(detector) is PlaneSweepDetector:
                self._search = SearchProcess(fork=True)
                self.detect = self._detector
        except OSError as error:  # no more processes can be started: go on with those there are
            _warn(str(error))

    @classmethod
    def of(cls, pairs: int, detector: Optional[str], *, beside: bool) -> Helpers:
        """
        Return the helpers that are worth their start-up time.

        :param pairs: number of pairs in the bag.
        :param detector: as for the class.
        :param beside: whether other cores are free for them.
        """
        beside = beside and len(os.sched_getaffinity(0)) > 1
        fewest = FEWEST_PAIRS if can_fork() else FEWEST_WITHOUT_FORK
        return cls(beside and pairs >= fewest, detector, ahead=beside)

    def __enter__(self) -> Helpers:
        """Return itself; shorten the switch interval of threads where pairs are read ahead."""
        self._turn_s = sys.getswitchinterval()
        if self.ahead:
            sys.setswitchinterval(min(self._turn_s, _TURN_S))
        return self

    def __exit__(self, kind: Optional[type[BaseException]], error: Optional[BaseException],
                 trace: Optional[TracebackType]) -> None:
        """End the processes and restore the switch interval."""
        sys.setswitchinterval(self._turn_s)
        if self.later is not None:
            self.later.close()
        for process in (self._search, self._pass):
            if process is not None:
                process.close()
        self._search = self._pass = None

    def _detector(self, rig: StereoRig, lanes: Mapping[str, LanePath], settings: Any
                  ) -> DetectorBeside:
        """Return a detector that runs in the search process once that is ready."""
        return DetectorBeside(None, rig, lanes, settings, self._search_failed, self._searching)

    def _searching(self) -> Optional[SearchProcess]:
        """Return the search process if it is ready."""
        if self._search is not None and not self._search_ready:
            try:
                self._search_ready = self._search.is_ready()
            except OSError as error:
                self._search_failed(str(error))
        return self._search if self._search_ready else None

    def _search_failed(self, why: str) -> None:
        """Go on without the search process."""
        _warn(f'search process: {why}')
        process, self._search, self._search_ready = self._search, None, False
        if process is not None:
            process.close(0.0)

    def _measured(self, measure: Measure) -> PassResult:
        """Return the result of a pass; called in the thread that concludes passes."""
        return measured_beside(self._measuring(), measure, self._pass_failed, lambda why: None)

    def _measuring(self) -> Optional[PassProcess]:
        """Wait for the process that measures passes, and return it; None where it failed."""
        process = self._pass
        if process is not None and not self._pass_ready:
            try:
                process.wait()
                self._pass_ready = True
            except OSError as error:
                self._pass_failed(process, str(error))
        return self._pass

    def _pass_failed(self, process: PassProcess, why: str) -> None:
        """Go on without the process that measures passes."""
        _warn(f'pass process: {why}')
        self._pass = None
        process.close(0.0)


def _warn(why: str) -> None:
    """Warn that the replay goes on without a process."""
    print(f'warning: {why}; continuing without this process, with the same results',
          file=sys.stderr)
