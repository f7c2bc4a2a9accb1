# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The processes that search for vehicles and measure passes for a measuring node.

Neither is waited for: the node does their work itself until they are ready, and after they have
failed.
"""
from __future__ import annotations

from functools import partial
from typing import Optional

from rclpy.impl.rcutils_logger import RcutilsLogger

from .helpers import Helpers
from .worker import Worker
from ..core.passes import PassResult
from ..detection.beside import DetectorBeside
from ..pipeline.assembly import MakeDetector
from ..pipeline.conclusions import Measure
from ..pipeline.pass_process import measured_beside
from ..pipeline.pipeline import SpeedPipeline


class MeasuringWorkers:
    """
    See the module's docstring.

    :param helpers: the node's helper processes.
    :param log: logger of the node.
    """

    def __init__(self, helpers: Helpers, log: RcutilsLogger) -> None:
        self._helpers, self._log = helpers, log
        self.searcher = Worker('searches for vehicles', helpers.search_process, log)
        self.passer = Worker('measures passes', helpers.pass_process, log)
        self._searches = False

    @property
    def faults(self) -> list[str]:
        """Return the present faults of the processes."""
        return [worker.fault for worker in (self.searcher, self.passer) if worker.fault]

    def start(self, *, searches: bool, measures: bool) -> None:
        """
        Begin to start the processes.

        :param searches: whether to search for vehicles in a process.
        :param measures: whether to measure passes in a process.
        """
        self._searches = searches
        for worker, needed in ((self.searcher, searches), (self.passer, measures)):
            if needed:
                worker.start()
        self._helpers.close()

    def revive(self) -> None:
        """Advance starts and restarts; to be called regularly."""
        self.searcher.revive()
        self.passer.revive()

    def close(self) -> None:
        """End the processes."""
        self.searcher.close()
        self.passer.close()

    def measured(self, measure: Measure) -> PassResult:
        """
        Return the result of a pass; called in the thread that measures passes.

        :param measure: measures the pass.
        """
        return measured_beside(
            self.passer.process, measure, self.passer.failed, lambda why: self._log.debug(
                f'a pass is measured without the pass process: {why}'))

    def detector(self) -> Optional[MakeDetector]:
        """Return the factory of a detector in another process; None where that is not used."""
        if not self._searches:
            return None
        process = self.searcher.process
        if process is None:
            return partial(DetectorBeside, None, failed=self._log.error)
        return partial(DetectorBeside, process, failed=partial(self.searcher.failed, process))

    def move_search(self, pipeline: SpeedPipeline) -> None:
        """Move the search of a pipeline to a restarted process, if there is one."""
        detector, process = pipeline.detector, self.searcher.process
        if process is not None and isinstance(detector, DetectorBeside) and detector.is_here:
            detector.move(process, partial(self.searcher.failed, process))
