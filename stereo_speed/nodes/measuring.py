# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Pairs in, tracks and passes out; shared by ``tracker_node`` and ``speed_camera_node``.

It runs the same pipeline as ``replay``, in a thread of its own, so that images are received while
it measures. Pairs are numbered from 0 since the start or the last jump of time, as is ``frame`` of
the init file. Jumps are detected by the stamps of pairs alone: ``/clock`` runs ahead of pairs that
are still queued, and would cut their pass short.

No pair and no calibration can stop it. A wrong configuration does, in the node's own thread.
"""
from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
import gc
import threading
import time
from typing import Callable, Optional, Sequence

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, PointCloud2

from .boxes import boxes_from_message, BOXES_TOPIC
from .calibration import CalibrationWatch
from .common import Parameters, qos_options, RELIABLE, stamp_ns
from .diagnostics import Task
from .health import Arrivals, ERROR, Refusals, Repeats, State, WARN
from .helpers import Helpers
from .measuring_settings import MeasuringSettings, MOST_REFINE_PAIRS
from .measuring_state import ClockSteps, Counts, tell_stamps, tell_steadiness
from .order_watch import OrderWatch
from .outputs import Outputs
from .pair_queue import PairQueue
from .rig_watch import RigWatch
from .self_test import SelfTestWatch
from .subscriptions import OfferedSubscription
from .worker import Worker
from ..core.compiled import warm_up
from ..core.errors import InputError, StereoSpeedError
from ..core.passes import PassResult, Reason
from ..core.records import StereoPair
from ..detection.beside import DetectorBeside
from ..detection.detector import PlaneSweepDetector
from ..detection.protocol import ImageBox, TakesBoxes
from ..pipeline.assembly import MakeDetector, MeasuringSite
from ..pipeline.conclusions import Beside, Measure
from ..pipeline.pass_process import measured_beside
from ..pipeline.pipeline import SpeedPipeline
from ..pipeline.registry import DETECTORS
from ..pipeline.solving import SolvingBeside
from ..site.calibration_age import calibration_age, CalibrationAge
from ..site.file import load_site
from ..site.init_file import load_init
from ..site.refine.report import report, summary_lines
from ..steadying.steadier import Steadier

_WAITING_PAIRS = 50  # number of pairs kept until both calibrations have arrived
_POLL_S = 0.1
_JOIN_S = 20.0  # longest time to finish measuring when the node stops


class MeasuringError(StereoSpeedError):
    """Measuring cannot begin now."""


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


class Measuring:
    """
    See the module's docstring.

    Its methods follow the lifecycle of the node: ``configure`` reads the site and subscribes to
    calibrations, ``activate`` measures, ``deactivate`` ends all passes, ``cleanup`` discards the
    configuration. Track numbers continue across all of these.

    :param node: the node that it works for.
    :param p: declares the parameters.
    :param outputs: publishes the results.
    :param helpers: the node's helper processes; None to start them when they are needed.
    :raises InputError: a parameter that cannot be used.
    """

    def __init__(self, node: Node, p: Parameters, outputs: Outputs,
                 helpers: Optional[Helpers] = None) -> None:
        self.node, self.outputs, self.log = node, outputs, node.get_logger()
        self.settings = settings = MeasuringSettings.declare(node, p)
        self.config = settings.config
        node.unused_parameters = settings.unused  # parameter files contain them all the same
        self.self_test = SelfTestWatch(node, p, self.config)
        self.rig_watch = RigWatch(p, self.log)
        self.configured = False
        self.refusals = Refusals(self.log.warning)
        self.counts = Counts()
        self._infos: list[OfferedSubscription] = []
        self.info_heard: list[Callable[[str, CameraInfo], None]] = []  # further callbacks
        self._boxes_subscription: Optional[Subscription] = None
        self._helpers = Helpers() if helpers is None else helpers
        self._searcher = Worker('searches for vehicles', self._helpers.search_process, self.log)
        self._passer = Worker('measures passes', self._helpers.pass_process, self.log)
        self._thread: Optional[threading.Thread] = None
        self._failure: Optional[BaseException] = None
        self._next_track = 0
        self._forget_calibrations()
        self._begin_anew()

    def _forget_calibrations(self) -> None:
        self.calibration, self._age = CalibrationWatch(self.refusals), CalibrationAge()
        self._begun = False

    def _begin_anew(self) -> None:
        """Discard the state of the stream, so that measuring begins with the next pair."""
        settings = self.settings
        self.queue: PairQueue[_Arrival] = PairQueue(
            settings.most_wait_s, max(_WAITING_PAIRS, MOST_REFINE_PAIRS), hurry=settings.hurry)
        self.pipeline: Optional[SpeedPipeline] = None
        self._conclusions: Optional[Beside] = None
        self._solving: Optional[SolvingBeside] = None
        self._adopted, self._unusable = 0, ''
        self._waiting: deque[_Arrival] = deque(maxlen=max(_WAITING_PAIRS, settings.refine_pairs))
        self._boxes: deque[tuple[int, list[ImageBox]]] = deque(maxlen=_WAITING_PAIRS)
        self._index, self._offered_ns, self._last_ns = 0, -1, -1
        self._repeats, self.arrivals = (Repeats(), Repeats()), Arrivals()
        self._steps = ClockSteps()
        self._order = OrderWatch()
        self._rig_moved = False
        self.counts.latencies_s.clear()
        self._stopping = threading.Event()

    @property
    def tasks(self) -> dict[str, Task]:
        """Return the tasks reported on ``/diagnostics``, by name."""
        return {'pipeline': self.state, 'stamps': self.stamps,
                'self-test': self.self_test.state, 'rig': self.rig_watch.state}

    # -- in the thread of the node ----------------------------------------------------------

    def configure(self) -> None:
        """
        Read the site and the init file, and subscribe to calibrations.

        :raises StereoSpeedError: a file is missing or cannot be used.
        """
        settings = self.settings
        if not settings.site_path:
            raise InputError(f'{self.node.get_name()}: parameter', 'site', 'nothing',
                             'the path of the site file')
        self.site = load_site(settings.site_path)
        self.annotations = load_init(settings.init_path) if settings.init_path else None
        # Neither is waited for, as their work is done in this process until they are ready.
        if self._searches_beside:
            self._searcher.start()
        if settings.pass_process:
            self._passer.start()
        self._helpers.close()
        self._infos = [
            OfferedSubscription(self.node, CameraInfo, f'{side}/camera_info',
                                partial(self._on_info, side))
            for side in ('left', 'right')]
        self._checks = self.node.create_timer(_POLL_S, self.check,
                                              clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.configured = True

    def _on_info(self, side: str, msg: CameraInfo) -> None:
        self.calibration.take(side, msg)
        for heard in self.info_heard:
            heard(side, msg)

    @property
    def _searches_beside(self) -> bool:
        return self.settings.detector_process and self.annotations is None \
            and DETECTORS.load(self.config.detector) is PlaneSweepDetector

    def _measured(self, measure: Measure) -> PassResult:
        """
        Return the result of a pass; called in the thread that measures passes.

        :param measure: measures the pass.
        """
        return measured_beside(
            self._passer.process, measure, self._passer.failed, lambda why: self.log.debug(
                f'a pass is measured without the pass process: {why}'))

    def _detect(self) -> Optional[MakeDetector]:
        """Return the factory of a detector in another process; None where that is not used."""
        if not self._searches_beside:
            return None
        process = self._searcher.process
        if process is None:
            return partial(DetectorBeside, None, failed=self.log.error)
        return partial(DetectorBeside, process, failed=partial(self._searcher.failed, process))

    def activate(self) -> None:
        """
        Begin to measure; from now on ``check`` raises errors of the measuring thread.

        :raises MeasuringError: the passes of the last activation are still being measured.
        """
        if self._thread is not None and self._thread.is_alive():
            raise MeasuringError('the last passes are still being measured')
        self.log.debug(f'kernels: {warm_up()}')  # now rather than in the first pairs
        if self._thread is not None:  # the last activation may have left garbage
            gc.collect()
        gc.freeze()  # present objects stay; scanning them takes a tenth of a second each time
        self._begin_anew()
        if hasattr(DETECTORS.load(self.config.detector), 'offer'):
            self._boxes_subscription = self.node.create_subscription(
                PointCloud2, BOXES_TOPIC, self.on_boxes, RELIABLE,
                qos_overriding_options=qos_options())
        self._thread = threading.Thread(target=self._work, name='measuring', daemon=True)
        self._thread.start()

    def deactivate(self) -> None:
        """End the passes that are still open, and stop measuring."""
        if self._boxes_subscription is not None:
            self.node.destroy_subscription(self._boxes_subscription)
            self._boxes_subscription = None
        self._stopping.set()
        self.queue.close()
        if self._thread is not None:
            self._thread.join(_JOIN_S)
            if self._thread.is_alive():
                self.log.warning(f'the last passes are still not measured after {_JOIN_S:.0f} s')
            else:
                self._order.close()
        self.rig_watch.close()

    def cleanup(self) -> None:
        """Discard the site and the calibrations."""
        self._searcher.close()
        self._passer.close()
        if not self.configured:
            return
        self.node.destroy_timer(self._checks)
        for subscription in self._infos:
            subscription.close()
        self.configured, self._infos = False, []
        self._forget_calibrations()

    @property
    def active(self) -> bool:
        """Return whether arriving pairs are measured."""
        return self._thread is not None and not self._stopping.is_set()

    def on_boxes(self, msg: PointCloud2) -> None:
        """Queue the boxes that another node found in a left image."""
        try:
            self._boxes.append((stamp_ns(msg.header.stamp), boxes_from_message(msg)))
        except InputError as error:
            self.refusals.add(BOXES_TOPIC, error)

    def offer(self, ns: int, pair: Callable[[int], StereoPair]) -> None:
        """
        Queue a pair that has arrived.

        :param ns: its stamp.
        :param pair: makes the pair from its number in the stream; called in the measuring thread.
        """
        if ns == self._offered_ns:
            self.counts.repeated += 1
            return
        if ns < self._offered_ns:
            self._index = 0
        self.arrivals.add()
        self.queue.put(_Arrival(self._index, ns, time.monotonic(), pair), ns)
        self._index, self._offered_ns = self._index + 1, ns

    def check(self) -> None:
        """
        Raise the error that ended the measuring thread; poll calibrations, workers, self-test.

        :raises StereoSpeedError: the site cannot be used with this rig.
        """
        if self._failure is not None:
            raise self._failure
        self.calibration.settle()
        self._searcher.revive()
        self._passer.revive()
        self.self_test.poll()
        self.outputs.tell_self_test(self.self_test.newest)

    # -- in the thread that measures --------------------------------------------------------

    def _work(self) -> None:
        try:
            while not self._stopping.is_set():
                self._adopt()
                self._correct()
                if self.pipeline is not None:
                    self._move_search(self.pipeline)
                    self._tell_passes(self.pipeline, self.pipeline.concluded())
                if not len(self.queue) or self.outputs.static_is_overdue:
                    self.outputs.publish_static()
                arrival = self._next(_POLL_S)
                if arrival is not None:
                    self._take(arrival)
                elif self.arrivals.silent_for(self.settings.silence_s):
                    self._end_passes()
            self._drain()
        except BaseException as error:  # raised by check(), in the thread that can end the node
            self._failure = error
        finally:
            self._give_up()

    def _drain(self) -> None:
        """Finish the pairs that arrived before the node was told to stop."""
        while (arrival := self._next(0.0)) is not None:
            self._take(arrival)
        if self._waiting:
            self.log.warning(f'{len(self._waiting)} pairs were not measured: '
                             f'{self.state().message}')
        self.outputs.publish_static()
        self._end_passes()
        self.outputs.wait()

    def _adopt(self) -> None:
        """Adopt the present calibration; end all passes if it has changed."""
        version = self.calibration.current[0]
        if version == self._adopted:
            return
        if self.pipeline is not None:
            self.log.warning('the calibration has changed: starting again')
            self._end_passes()
            self._give_up()
        self._adopted, self._unusable = version, ''

    def _correct(self) -> None:
        """Measure with a correction of the rig once looks at it have confirmed one."""
        stance, pipeline, newest = (
            self.rig_watch.pop_correction(), self.pipeline, self.rig_watch.newest)
        if stance is None or pipeline is None or newest is None:
            return
        try:
            self._measure_at(MeasuringSite(stance.site, stance.rig, stance.lanes, corrected=True),
                             newest.text)
        except StereoSpeedError as error:  # looks continue, and measuring stays suspended
            self.log.error(f'cannot measure with the corrected rig: {error}')
        else:
            self.log.warning(f'measuring with the corrected rig: {newest.text}')

    def _move_search(self, pipeline: SpeedPipeline) -> None:
        """Move the search to a restarted process, if there is one."""
        detector, process = pipeline.detector, self._searcher.process
        if process is not None and isinstance(detector, DetectorBeside) and detector.is_here:
            detector.move(process, partial(self._searcher.failed, process))

    def _give_up(self) -> None:
        """Close the pipeline, whose passes have been published."""
        if self.pipeline is not None:
            self._next_track, self.pipeline = self.pipeline.next_track, None
        if self._conclusions is not None:
            self._conclusions.close()
            self._conclusions = None
        if self._solving is not None:
            self._solving.close()
            self._solving = None

    def _next(self, timeout_s: float) -> Optional[_Arrival]:
        """Return the pair to measure next, if one comes in time; count those skipped before."""
        arrival, skipped_ns = self.queue.take(timeout_s), self.queue.skipped_ns
        self.counts.skipped.add(len(skipped_ns))
        for ns in skipped_ns:
            self._pass_over(ns)
        return arrival

    def _take(self, arrival: _Arrival) -> None:
        """Measure a pair, or keep it until the pipeline can be made."""
        if self._unusable:
            self.counts.withheld += 1
            return
        if self.pipeline is not None:
            self._process(self.pipeline, arrival)
            return
        if self._waiting and arrival.ns <= self._waiting[-1].ns:
            self.log.warning('stamps jumped back: waiting pairs discarded')
            self._waiting.clear()
        if len(self._waiting) == self._waiting.maxlen:
            self.counts.early.add()
        self._waiting.append(arrival)
        self._begin()

    def _begin(self) -> None:
        """Make the pipeline once the rig is known and the pairs to refine the site are there."""
        settings, (self._adopted, rig) = self.settings, self.calibration.current
        if rig is None or len(self._waiting) < settings.refine_pairs:
            return
        pairs = [
            pair for arrival in self._waiting
            if (pair := self._pair_of(arrival)) is not None] if settings.refine_pairs else None
        with suppress(InputError):  # the error is reported when the pair is measured
            first = self._waiting[0]
            self._order.begin(rig, first.pair(first.index))  # runs while the pipeline is made
        try:
            place = MeasuringSite.of(self.site, rig, pairs, self.config.site)
            pipeline = self._measure_at(place)
        except StereoSpeedError as error:
            if not self._begun:
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
                self.counts.early.add()
                self._pass_over(arrival.ns)
        self.queue.ready()

    def _measure_at(self, place: MeasuringSite, corrected: str = '') -> SpeedPipeline:
        """
        Measure at a site from now on.

        :param place: the site.
        :param corrected: what was wrong with the site as read; empty if nothing was.
        """
        conclusions = Beside(failed=self._pass_failed, measured=self._measured)
        solving = SolvingBeside() if self.settings.hurry else None
        pipeline = place.pipeline(self.config, self.annotations, conclusions=conclusions,
                                  solving=solving, detect=self._detect(), seed=self.settings.seed,
                                  where=self.settings.init_path)
        self._give_up()
        pipeline.next_track, self._begun, self.pipeline = self._next_track, True, pipeline
        self._conclusions, self._solving = conclusions, solving
        self.outputs.begin(pipeline, place, self.config)
        self.rig_watch.begin(place, self.config.site, corrected)
        return pipeline

    def _told(self, place: MeasuringSite) -> None:
        """Log how the site was refined."""
        if place.refined is not None:
            for line in summary_lines(place.refined, report(place.refined)):
                self.log.info(line)
        if place.not_refined:
            self.log.warning(f'site not refined, used as written: {place.not_refined}')

    def _pair_of(self, arrival: _Arrival) -> Optional[StereoPair]:
        """Return the pair that has arrived; None, and report it, where it cannot be used."""
        try:
            return arrival.pair(arrival.index)
        except InputError as error:
            self.refusals.add('pair', error)
            return None

    def _process(self, pipeline: SpeedPipeline, arrival: _Arrival) -> None:
        """Run the pipeline on a pair and publish the results."""
        self._mind_time(pipeline, arrival.ns)
        pair = self._pair_of(arrival)
        withheld = pair is not None and self._is_withheld(pair)
        self._mind_rig(pipeline)
        if pair is None or withheld:
            self._tell_stamp(pipeline, arrival.ns)
            return
        detector = pipeline.detector
        while isinstance(detector, TakesBoxes) and self._boxes:
            detector.offer(*self._boxes.popleft())
        hurried = self.queue.hurried
        self.counts.hurried.add(hurried)
        try:
            step = pipeline.process(
                pair, hurried, partial(self.outputs.tell_readings, pipeline))
        except InputError as error:
            self.refusals.add('pair', error)
            return
        except Exception as error:
            self._failed(pipeline, arrival.ns, error)
            return
        self.counts.passes += len(step.passes)
        self.outputs.tell(pipeline, pair, step)
        self.counts.measured.add()
        self.counts.latencies_s.append(time.monotonic() - arrival.came_s)

    @property
    def _steadier(self) -> Optional[Steadier]:
        return None if self.pipeline is None else self.pipeline.doubt.steadier

    def _mind_rig(self, pipeline: SpeedPipeline) -> None:
        """Reject open passes if a look has just found that the rig has moved."""
        moved = self.rig_watch.withholds
        if moved and not self._rig_moved:
            self._tell_passes(pipeline, [
                result.rejected(Reason.RIG_UNCERTAIN) for result in pipeline.finish()])
            pipeline.reset()
        self._rig_moved = moved

    def _is_withheld(self, pair: StereoPair) -> bool:
        """Return whether a pair must not be measured: an image repeats, or a fault forbids it."""
        same = [r.add(image) for r, image in zip(self._repeats, (pair.left, pair.right))]
        self.counts.frozen.add(any(same))
        if not any(same):
            steadier = self._steadier
            self.rig_watch.take(pair, None if steadier is None else steadier.rest)
        self._age = calibration_age(
            self.site.calibrated, pair.stamp_ns, self.settings.calibration_months)
        moot = (not self.calibration.holds(self._adopted) or self._is_crossed(pair)
                or self.self_test.withholds or self.rig_watch.withholds or self._age.expired)
        self.counts.withheld += moot
        return any(same) or moot

    def _is_crossed(self, pair: StereoPair) -> bool:
        """Return whether the views are swapped."""
        rig = self.calibration.current[1]
        return self._order.crossed if rig is None else self._order.take(rig, pair)

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
        self.counts.failed.add()
        self.refusals.add('pipeline', f'pair at {ns} ns: {error!r}; all tracks are discarded')
        pipeline.reset()

    def _mind_time(self, pipeline: SpeedPipeline, ns: int) -> None:
        """End all passes if time has jumped back."""
        last_ns, self._last_ns = self._last_ns, ns
        if ns >= last_ns:
            return
        self.log.warning(f'stamps jumped back from {last_ns} to {ns} ns: starting again')
        self._end_passes()
        pipeline.reset()
        self.counts.resets.add()

    def _end_passes(self) -> None:
        if self.pipeline is not None:
            self._tell_passes(self.pipeline, self.pipeline.finish())

    def _tell_passes(self, pipeline: SpeedPipeline, results: Sequence[PassResult]) -> None:
        self.counts.passes += len(results)
        self.outputs.end(pipeline, results)

    def _pass_failed(self, error: Exception) -> None:
        """Count a pass that has no result because of an internal error."""
        self.counts.failed.add()
        self.refusals.add('pass', f'a pass has no result: {error!r}')

    # -- diagnostics ------------------------------------------------------------------------

    def state(self) -> State:
        """Return the state of the measurement for ``/diagnostics``."""
        state, queue, conclusions = State('measuring'), self.queue, self._conclusions
        if not self.active:
            state.find(WARN, 'inactive' if self.configured else 'not configured')
            return state
        self.arrivals.tell(state, 'pair', 'pair')
        state.values.update(
            run=self.outputs.run, waiting=len(self._waiting) + len(queue),
            passes_waiting=0 if conclusions is None else conclusions.waiting)
        self.calibration.tell(state)
        if self._unusable:
            state.find(ERROR, self._unusable)
        if self.pipeline is None and self.calibration.current[1] is not None \
                and self.settings.refine_pairs:
            state.find(WARN, 'waiting to refine the site')
        if self._order.crossed:
            state.find(ERROR, 'the views are swapped: nothing is measured')
        self.counts.tell(state)
        for fault in filter(None, (self._searcher.fault, self._passer.fault)):
            state.find(WARN, fault)
        if self._age.text:
            state.find(ERROR if self._age.expired else WARN, self._age.text)
        self.refusals.tell(state)
        if self._steadier is not None:
            tell_steadiness(self._steadier, state)
        return state

    def stamps(self) -> State:
        """Return the state of the stamps for ``/diagnostics``."""
        pipeline = self.pipeline
        if pipeline is None:
            return State('stamps not checked yet, as no pair is measured')
        state = State('no fault in the stamps')
        self._steps.tell(pipeline, state)
        tell_stamps(pipeline, state)
        return state
