# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What a replay has done on another core.

A thread reads and decodes pairs ahead.  Two processes do part of the rest: one searches for
vehicles while the tracks of the pairs are updated, one measures passes that are over while the
pairs that follow are.  What is written is the same to the last bit, with them, without them, and
where one dies: each does what would be done here, and is asked in order.
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

# They save some four milliseconds a pair.  Forks take less than a tenth of a second, others four.
FEWEST_PAIRS, FEWEST_WITHOUT_FORK = 60, 1500
# After which a thread gives way to another that asks: what reads ahead asks ten times a pair.
_TURN_S = 5e-4


class Helpers:
    """
    What helps one replay; a context manager.

    :param processes: whether there are to be any.
    :param detector: name of the detector; None where vehicles are annotated.
    :param ahead: whether pairs are to be read ahead.
    """

    def __init__(self, processes: bool, detector: Optional[str], *, ahead: bool = True) -> None:
        self.ahead = ahead
        self._search: Optional[SearchProcess] = None
        self._pass: Optional[PassProcess] = None
        self._search_ready = self._pass_ready = False
        self.later: Optional[Later] = None  # measures passes; None has the pipeline do it
        self.detect: Optional[MakeDetector] = None  # makes its detector; None as ever
        if not processes:
            return
        try:
            warm_up()  # what is here is in its forks
            self._pass = PassProcess(fork=True)
            self.later = Later(self._measured)
            if detector is not None and DETECTORS.load(detector) is PlaneSweepDetector:
                self._search = SearchProcess(fork=True)
                self.detect = self._detector
        except OSError as error:  # no more processes: what there is will do
            _warn(str(error))

    @classmethod
    def of(cls, pairs: int, detector: Optional[str], *, beside: bool) -> Helpers:
        """
        Return what pays.

        :param pairs: of the bag.
        :param detector: as above.
        :param beside: whether other cores are free for them.
        """
        beside = beside and len(os.sched_getaffinity(0)) > 1
        fewest = FEWEST_PAIRS if can_fork() else FEWEST_WITHOUT_FORK
        return cls(beside and pairs >= fewest, detector, ahead=beside)

    def __enter__(self) -> Helpers:
        """Return itself; threads take shorter turns from now on, where there are any."""
        self._turn_s = sys.getswitchinterval()
        if self.ahead:
            sys.setswitchinterval(min(self._turn_s, _TURN_S))
        return self

    def __exit__(self, kind: Optional[type[BaseException]], error: Optional[BaseException],
                 trace: Optional[TracebackType]) -> None:
        """End the processes."""
        sys.setswitchinterval(self._turn_s)
        if self.later is not None:
            self.later.close()
        for process in (self._search, self._pass):
            if process is not None:
                process.close()
        self._search = self._pass = None

    def _detector(self, rig: StereoRig, lanes: Mapping[str, LanePath], settings: Any
                  ) -> DetectorBeside:
        """Return a detector that moves to the process once that is ready."""
        return DetectorBeside(None, rig, lanes, settings, self._search_failed, self._searching)

    def _searching(self) -> Optional[SearchProcess]:
        """Return the process that searches, where it is ready."""
        if self._search is not None and not self._search_ready:
            try:
                self._search_ready = self._search.is_ready()
            except OSError as error:
                self._search_failed(str(error))
        return self._search if self._search_ready else None

    def _search_failed(self, why: str) -> None:
        """Do without the process that searches."""
        _warn(f'search process: {why}')
        process, self._search, self._search_ready = self._search, None, False
        if process is not None:
            process.close(0.0)

    def _measured(self, measure: Measure) -> PassResult:
        """Return the result of a pass; in the thread of the passes."""
        return measured_beside(self._measuring(), measure, self._pass_failed, lambda why: None)

    def _measuring(self) -> Optional[PassProcess]:
        """Return the process that measures passes, once it is ready."""
        process = self._pass
        if process is not None and not self._pass_ready:
            try:
                process.wait()
                self._pass_ready = True
            except OSError as error:
                self._pass_failed(process, str(error))
        return self._pass

    def _pass_failed(self, process: PassProcess, why: str) -> None:
        """Do without the process that measures passes."""
        _warn(f'pass process: {why}')
        self._pass = None
        process.close(0.0)


def _warn(why: str) -> None:
    """Say that it goes on without a process."""
    print(f'warning: {why}; continuing without this process, with the same results',
          file=sys.stderr)
