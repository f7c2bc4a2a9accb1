# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The thread of a measuring node that measures: pairs in, tracks and passes out.

It runs the same pipeline as ``replay``. Pairs are numbered from 0 since the start or the last jump
of time, as is ``frame`` of the init file. Jumps are detected by the stamps of pairs alone:
``/clock`` runs ahead of pairs that are still queued, and would cut their pass short.

No pair and no calibration can stop it. A wrong configuration does; the node's own thread then
raises the error.
"""
from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
import threading
import time
from typing import Callable, Optional, Sequence

from .admission import Admission
from .health import Arrivals, ERROR, State, WARN
from .measuring_context import Configuration, MeasuringContext
from .measuring_settings import MOST_REFINE_PAIRS
from .measuring_state import ClockSteps, STAMPS_UNKNOWN, tell_rig, tell_stamps
from .pair_queue import PairQueue
from ..core.errors import InputError, StereoSpeedError
from ..core.passes import PassResult, Reason
from ..core.records import StereoPair
from ..detection.protocol import ImageBox, TakesBoxes
from ..geometry.rig import StereoRig
from ..pipeline.assembly import MeasuringSite
from ..pipeline.conclusions import Beside
from ..pipeline.pipeline import SpeedPipeline
from ..pipeline.solving import SolvingBeside
from ..site.refine.report import report, summary_lines

_WAITING_PAIRS = 50  # number of pairs kept until both calibrations have arrived
_WAIT_S = 0.1


@dataclass(frozen=True, eq=False)
class _Arrival:
    """
    A pair that has arrived.

    :param index: its number since the start or the last jump of time.
    :param ns: its stamp.
    :param came_s: steady time of its arrival.
    :param pair: makes the pair from its number; may raise InputError.
    """

    index: int
    ns: int
    came_s: float
    pair: Callable[[int], StereoPair]


class MeasuringThread:
    """
    See the module's docstring; one for each activation of a node.

    The node's thread calls ``start``, ``offer``, ``offer_boxes``, ``stop`` and what reports.

    :param context: what the node's threads share.
    :param configuration: its configuration.
    """

    def __init__(self, context: MeasuringContext, configuration: Configuration) -> None:
        self._context, self._configuration = context, configuration
        self._log, self._outputs, self._workers = context.log, context.outputs, context.workers
        self._refusals, self._counts = context.refusals, context.counts
        self._calibration, self._rig_watch = configuration.calibration, context.rig_watch
        self._settings = settings = context.settings
        self._config = settings.config
        self.queue: PairQueue[_Arrival] = PairQueue(
            settings.most_wait_s, max(_WAITING_PAIRS, MOST_REFINE_PAIRS), hurry=settings.hurry)
        self.pipeline: Optional[SpeedPipeline] = None
        self.failure: Optional[BaseException] = None
        self._conclusions: Optional[Beside] = None
        self._solving: Optional[SolvingBeside] = None
        self._adopted, self._unusable = 0, ''
        self._waiting: deque[_Arrival] = deque(maxlen=max(_WAITING_PAIRS, settings.refine_pairs))
        self._boxes: deque[tuple[int, list[ImageBox]]] = deque(maxlen=_WAITING_PAIRS)
        self._index, self._offered_ns, self._last_ns = 0, -1, -1
        self._admission, self._arrivals = Admission(context, configuration), Arrivals()
        self._steps = ClockSteps()
        self._rig_moved = False
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._work, name='measuring', daemon=True)

    # -- in the thread of the node ----------------------------------------------------------

    @property
    def active(self) -> bool:
        """Return whether arriving pairs are measured."""
        return not self._stopping.is_set()

    @property
    def alive(self) -> bool:
        """Return whether passes are still being measured, even if it was told to stop."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Start to measure."""
        self._counts.latencies_s.clear()
        self._thread.start()

    def offer(self, ns: int, pair: Callable[[int], StereoPair]) -> None:
        """
        Queue a pair that has arrived.

        :param ns: its stamp.
        :param pair: makes the pair from its number in the stream; called in the measuring thread.
        """
        if ns == self._offered_ns:
            self._counts.repeated += 1
            return
        if ns < self._offered_ns:
            self._index = 0
        self._arrivals.add()
        self.queue.put(_Arrival(self._index, ns, time.monotonic(), pair), ns)
        self._index, self._offered_ns = self._index + 1, ns

    def offer_boxes(self, ns: int, boxes: list[ImageBox]) -> None:
        """Queue the boxes that another node found in the left image of a stamp."""
        self._boxes.append((ns, boxes))

    def stop(self, most_s: float) -> None:
        """End the passes that are still open; wait for that at most as long as given, s."""
        self._stopping.set()
        self.queue.close()
        self._thread.join(most_s)
        if self._thread.is_alive():
            self._log.warning(f'the last passes are still not measured after {most_s:.0f} s')
        else:
            self._admission.close()

    # -- in the thread that measures --------------------------------------------------------

    def _work(self) -> None:
        try:
            while not self._stopping.is_set():
                self._adopt()
                self._correct()
                if self.pipeline is not None:
                    self._workers.move_search(self.pipeline)
                    self._tell_passes(self.pipeline, self.pipeline.concluded())
                if not len(self.queue) or self._outputs.static_is_overdue:
                    self._outputs.publish_static()
                arrival = self._next(_WAIT_S)
                if arrival is not None:
                    self._take(arrival)
                elif self._arrivals.silent_for(self._settings.silence_s):
                    self._end_passes()
            self._drain()
        except BaseException as error:  # the other thread can end the node and raises it
            self.failure = error
        finally:
            self._give_up()

    def _drain(self) -> None:
        """Finish the pairs that arrived before the node was told to stop."""
        while (arrival := self._next(0.0)) is not None:
            self._take(arrival)
        if self._waiting:
            self._log.warning(f'{len(self._waiting)} pairs were not measured: '
                              f'{self.state().message}')
        self._outputs.publish_static()
        self._end_passes()
        self._outputs.wait()

    def _adopt(self) -> None:
        """Adopt the present calibration; end all passes if it has changed."""
        version = self._calibration.current[0]
        if version == self._adopted:
            return
        if self.pipeline is not None:
            self._log.warning('the calibration has changed: starting again')
            self._end_passes()
            self._give_up()
        self._adopted, self._unusable = version, ''

    def _correct(self) -> None:
        """Measure with a correction of the rig once looks at it have confirmed one."""
        stance, pipeline, newest = (
            self._rig_watch.pop_correction(), self.pipeline, self._rig_watch.newest)
        if stance is None or pipeline is None or newest is None:
            return
        try:
            self._measure_at(MeasuringSite(stance.site, stance.rig, stance.lanes, corrected=True),
                             newest.text)
        except StereoSpeedError as error:  # looks continue, and measuring stays suspended
            self._log.error(f'cannot measure with the corrected rig: {error}')
        else:
            self._log.warning(f'measuring with the corrected rig: {newest.text}')

    def _give_up(self) -> None:
        """Close the pipeline, whose passes have been published."""
        if self.pipeline is not None:
            self._context.next_track, self.pipeline = self.pipeline.next_track, None
        if self._conclusions is not None:
            self._conclusions.close()
            self._conclusions = None
        if self._solving is not None:
            self._solving.close()
            self._solving = None

    def _next(self, timeout_s: float) -> Optional[_Arrival]:
        """Return the pair to measure next, if one comes in time; count those skipped before."""
        arrival, skipped_ns = self.queue.take(timeout_s), self.queue.skipped_ns
        self._counts.skipped.add(len(skipped_ns))
        for ns in skipped_ns:
            self._pass_over(ns)
        return arrival

    def _take(self, arrival: _Arrival) -> None:
        """Measure a pair, or keep it until the pipeline can be made."""
        if self._unusable:
            self._counts.withheld += 1
            return
        if self.pipeline is not None:
            self._process(self.pipeline, arrival)
            return
        if self._waiting and arrival.ns <= self._waiting[-1].ns:
            self._log.warning('stamps jumped back: waiting pairs discarded')
            self._waiting.clear()
        if len(self._waiting) == self._waiting.maxlen:
            self._counts.early.add()
        self._waiting.append(arrival)
        self._begin()

    def _begin(self) -> None:
        """Make the pipeline once the rig is known and the pairs to refine the site are there."""
        settings, (self._adopted, rig) = self._settings, self._calibration.current
        if rig is None or len(self._waiting) < settings.refine_pairs:
            return
        pairs = self._fitting(rig) if settings.refine_pairs else None
        if pairs is not None and len(pairs) < settings.refine_pairs:
            return
        with suppress(InputError):  # the error is reported when the pair is measured
            first = self._waiting[0]
            self._admission.begin(rig, first.pair(first.index))  # runs while the pipeline is made
        try:
            place = MeasuringSite.of(self._configuration.site, rig, pairs, self._config.site)
            pipeline = self._measure_at(place)
        except StereoSpeedError as error:
            if not self._configuration.begun:
                raise  # the configuration is wrong
            self._unusable = str(error)
            self._waiting.clear()
            return
        self._told(place)
        since_s = time.monotonic() - settings.most_wait_s
        while self._waiting:
            arrival = self._waiting.popleft()
            # Pairs that the site was refined by had to wait, so they are never too old.
            if settings.refine_pairs or arrival.came_s > since_s:
                self._process(pipeline, arrival)
            else:
                self._counts.early.add()
                self._pass_over(arrival.ns)
        self.queue.ready()

    def _fitting(self, rig: StereoRig) -> list[StereoPair]:
        """
        Return the waiting pairs to refine the site by; those that cannot be used wait no longer.

        While cameras are being set up, pairs may not have the size of the calibration.
        """
        pairs = []
        for arrival in list(self._waiting):
            pair = self._pair_of(arrival, rig)
            if pair is None:
                self._waiting.remove(arrival)
            else:
                pairs.append(pair)
        return pairs

    def _measure_at(self, place: MeasuringSite, corrected: str = '') -> SpeedPipeline:
        """
        Measure at a site from now on.

        :param place: the site.
        :param corrected: what was wrong with the site as read; empty if nothing was.
        """
        conclusions = Beside(failed=self._pass_failed, measured=self._workers.measured)
        solving = SolvingBeside() if self._settings.hurry else None
        pipeline = place.pipeline(
            self._config, self._configuration.annotations, conclusions=conclusions,
            solving=solving, detect=self._workers.detector(), seed=self._settings.seed,
            where=self._settings.init_path)
        self._give_up()
        pipeline.next_track, self.pipeline = self._context.next_track, pipeline
        self._configuration.begun = True
        self._conclusions, self._solving = conclusions, solving
        self._outputs.begin(pipeline, place, self._config)
        self._rig_watch.begin(place, self._config.site, corrected)
        return pipeline

    def _told(self, place: MeasuringSite) -> None:
        """Log how the site was refined."""
        if place.refined is not None:
            for line in summary_lines(place.refined, report(place.refined)):
                self._log.info(line)
        if place.not_refined:
            self._log.warning(f'site not refined, used as written: {place.not_refined}')

    def _pair_of(self, arrival: _Arrival, rig: Optional[StereoRig] = None
                 ) -> Optional[StereoPair]:
        """
        Return the pair that has arrived; None, and report it, where it cannot be used.

        :param rig: rig whose calibration it must fit; None where the pipeline checks that.
        """
        try:
            pair = arrival.pair(arrival.index)
            if rig is not None:
                rig.check_sizes(pair)
            return pair
        except InputError as error:
            self._refusals.add('pair', error)
            return None

    def _process(self, pipeline: SpeedPipeline, arrival: _Arrival) -> None:
        """Run the pipeline on a pair and publish the results."""
        self._mind_time(pipeline, arrival.ns)
        pair = self._pair_of(arrival)
        admitted = pair is not None and self._admission.admit(
            pair, self._adopted, pipeline.doubt.steadier)
        self._mind_rig(pipeline)
        if pair is None or not admitted:
            self._tell_stamp(pipeline, arrival.ns)
            return
        detector = pipeline.detector
        while isinstance(detector, TakesBoxes) and self._boxes:
            detector.offer(*self._boxes.popleft())
        hurried = self.queue.hurried
        self._counts.hurried.add(hurried)
        try:
            step = pipeline.process(
                pair, hurried, partial(self._outputs.tell_readings, pipeline))
        except InputError as error:
            self._refusals.add('pair', error)
            return
        except Exception as error:
            self._failed(pipeline, arrival.ns, error)
            return
        self._counts.passes += len(step.passes)
        self._outputs.tell(pipeline, pair, step)
        self._counts.measured.add()
        self._counts.latencies_s.append(time.monotonic() - arrival.came_s)

    def _mind_rig(self, pipeline: SpeedPipeline) -> None:
        """Reject open passes if a look has just found that the rig has moved."""
        moved = self._rig_watch.withholds
        if moved and not self._rig_moved:
            self._tell_passes(pipeline, [
                result.rejected(Reason.RIG_UNCERTAIN) for result in pipeline.finish()])
            pipeline.reset()
        self._rig_moved = moved

    def _pass_over(self, ns: int) -> None:
        """Tell the pipeline, if there is one, the stamp of a pair that is skipped."""
        if self.pipeline is not None:
            self._mind_time(self.pipeline, ns)
            self._tell_stamp(self.pipeline, ns)

    def _tell_stamp(self, pipeline: SpeedPipeline, ns: int) -> None:
        """Tell the pipeline the stamp of a pair that is not measured."""
        try:
            pipeline.pass_over(ns)
        except Exception as error:
            self._failed(pipeline, ns, error)

    def _failed(self, pipeline: SpeedPipeline, ns: int, error: Exception) -> None:
        """Report an internal error in one pair, which must not stop the instrument."""
        self._counts.failed.add()
        self._refusals.add('pipeline', f'pair at {ns} ns: {error!r}; all tracks are discarded')
        pipeline.reset()

    def _mind_time(self, pipeline: SpeedPipeline, ns: int) -> None:
        """End all passes if time has jumped back."""
        last_ns, self._last_ns = self._last_ns, ns
        if ns >= last_ns:
            return
        self._log.warning(f'stamps jumped back from {last_ns} to {ns} ns: starting again')
        self._end_passes()
        pipeline.reset()
        self._counts.resets.add()

    def _end_passes(self) -> None:
        if self.pipeline is not None:
            self._tell_passes(self.pipeline, self.pipeline.finish())

    def _tell_passes(self, pipeline: SpeedPipeline, results: Sequence[PassResult]) -> None:
        self._counts.passes += len(results)
        self._outputs.end(pipeline, results)

    def _pass_failed(self, error: Exception) -> None:
        """Count a pass that has no result because of an internal error."""
        self._counts.failed.add()
        self._refusals.add('pass', f'a pass has no result: {error!r}')

    # -- in either thread -------------------------------------------------------------------

    def state(self) -> State:
        """Return the state of the measurement for ``/diagnostics``."""
        state, conclusions, pipeline = State('measuring'), self._conclusions, self.pipeline
        self._arrivals.tell(state, 'pair', 'pair')
        state.values.update(
            run=self._outputs.run, waiting=len(self._waiting) + len(self.queue),
            passes_waiting=0 if conclusions is None else conclusions.waiting)
        self._calibration.tell(state)
        if self._unusable:
            state.find(ERROR, self._unusable)
        if pipeline is None and self._calibration.current[1] is not None \
                and self._settings.refine_pairs:
            state.find(WARN, 'waiting to refine the site')
        self._admission.tell(state)
        self._counts.tell(state)
        for fault in self._workers.faults:
            state.find(WARN, fault)
        self._refusals.tell(state)
        if pipeline is not None:
            tell_rig(pipeline.doubt, state)
        return state

    def stamps(self) -> State:
        """Return the state of the stamps for ``/diagnostics``."""
        pipeline = self.pipeline
        if pipeline is None:
            return State(STAMPS_UNKNOWN)
        state = State('no fault in the stamps')
        self._steps.tell(pipeline, state)
        tell_stamps(pipeline, state)
        return state
