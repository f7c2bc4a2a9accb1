# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Pairs in, tracks and passes out; shared by ``tracker_node`` and ``speed_camera_node``.

This is the side of the node's own thread: parameters, lifecycle, subscriptions, diagnostics.  The
measuring is in ``measuring_thread``, so that images are received meanwhile.
"""
from __future__ import annotations

from functools import partial
import gc
from typing import Callable, Optional

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import CameraInfo, PointCloud2

from .boxes import boxes_from_message, BOXES_TOPIC
from .calibration import CalibrationWatch
from .common import Parameters, qos_options, RELIABLE, stamp_ns
from .diagnostics import Task
from .health import Refusals, State, WARN
from .helpers import Helpers
from .measuring_context import Configuration, MeasuringContext
from .measuring_settings import MeasuringSettings
from .measuring_state import STAMPS_UNKNOWN
from .measuring_thread import MeasuringThread
from .measuring_workers import MeasuringWorkers
from .outputs import Outputs
from .rig_watch import RigWatch
from .self_test import SelfTestWatch
from .subscriptions import OfferedSubscription
from ..core.compiled import warm_up
from ..core.errors import InputError, StereoSpeedError
from ..core.records import StereoPair
from ..detection.detector import PlaneSweepDetector
from ..pipeline.registry import DETECTORS
from ..site.file import load_site
from ..site.init_file import load_init

_POLL_S = 0.1
_JOIN_S = 20.0  # longest time to finish measuring when the node stops


class MeasuringError(StereoSpeedError):
    """Measuring cannot begin now."""


class Measuring:
    """
    See the module's docstring.

    Its methods follow the lifecycle of the node: ``configure`` reads the site and subscribes to
    calibrations, ``activate`` measures, ``deactivate`` ends all passes, ``cleanup`` discards the
    configuration, ``close`` ends the rest. Track numbers continue across all but the last.

    :param node: the node that it works for.
    :param p: declares the parameters.
    :param outputs: publishes the results.
    :param helpers: the node's helper processes; None to start them when they are needed.
    :raises InputError: a parameter that cannot be used.
    """

    def __init__(self, node: Node, p: Parameters, outputs: Outputs,
                 helpers: Optional[Helpers] = None) -> None:
        self.node, self.log = node, node.get_logger()
        settings = MeasuringSettings.declare(node, p)
        node.unused_parameters = settings.unused  # parameter files contain them all the same
        self.context = MeasuringContext(
            log=self.log, settings=settings, outputs=outputs,
            workers=MeasuringWorkers(Helpers() if helpers is None else helpers, self.log),
            self_test=SelfTestWatch(node, p, settings.config), rig_watch=RigWatch(p, self.log),
            refusals=Refusals(self.log.warning))
        self.info_heard: list[Callable[[str, CameraInfo], None]] = []  # further callbacks
        self.configuration: Optional[Configuration] = None
        self.thread: Optional[MeasuringThread] = None
        self._infos: list[OfferedSubscription] = []
        self._checks: Optional[Timer] = None
        self._boxes: Optional[Subscription] = None

    @property
    def tasks(self) -> dict[str, Task]:
        """Return the tasks reported on ``/diagnostics``, by name."""
        return {'pipeline': self.state, 'stamps': self.stamps,
                'self-test': self.context.self_test.state, 'rig': self.context.rig_watch.state}

    def configure(self) -> None:
        """
        Read the site and the init file, and subscribe to calibrations.

        :raises StereoSpeedError: a file is missing or cannot be used.
        """
        settings = self.context.settings
        if not settings.site_path:
            raise InputError(f'{self.node.get_name()}: parameter', 'site', 'nothing',
                             'the path of the site file')
        site = load_site(settings.site_path)
        annotations = load_init(settings.init_path) if settings.init_path else None
        self.context.workers.start(
            searches=settings.detector_process and annotations is None
            and DETECTORS.load(settings.config.detector) is PlaneSweepDetector,
            measures=settings.pass_process)
        calibration = CalibrationWatch(self.context.refusals)
        for side in ('left', 'right'):  # if the second fails, cleanup closes the first
            self._infos.append(OfferedSubscription(
                self.node, CameraInfo, f'{side}/camera_info',
                partial(self._on_info, calibration, side)))
        self._checks = self.node.create_timer(_POLL_S, partial(self.check, calibration),
                                              clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.configuration = Configuration(site, annotations, calibration)

    def _on_info(self, calibration: CalibrationWatch, side: str, msg: CameraInfo) -> None:
        calibration.take(side, msg)
        for heard in self.info_heard:
            heard(side, msg)

    def activate(self) -> None:
        """
        Begin to measure; from now on ``check`` raises errors of the measuring thread.

        :raises MeasuringError: the node is not configured, or the passes of the last activation
            are still being measured.
        """
        if self.configuration is None:
            raise MeasuringError('not configured')
        if self.thread is not None and self.thread.alive:
            raise MeasuringError('the last passes are still being measured')
        self.log.debug(f'kernels: {warm_up()}')  # now rather than in the first pairs
        if self.thread is not None:  # the last activation may have left garbage
            gc.collect()
        gc.freeze()  # present objects stay; scanning them takes a tenth of a second each time
        thread = MeasuringThread(self.context, self.configuration)
        if hasattr(DETECTORS.load(self.context.settings.config.detector), 'offer'):
            self._boxes = self.node.create_subscription(
                PointCloud2, BOXES_TOPIC, partial(self.on_boxes, thread), RELIABLE,
                qos_overriding_options=qos_options())
        thread.start()
        self.thread = thread

    def deactivate(self) -> None:
        """End the passes that are still open, and stop measuring."""
        if self._boxes is not None:
            self.node.destroy_subscription(self._boxes)
            self._boxes = None
        if self.thread is not None:
            self.thread.stop(_JOIN_S)
        self.context.rig_watch.close()

    def cleanup(self) -> None:
        """Discard the site and the calibrations."""
        self.context.workers.close()
        if self._checks is not None:
            self.node.destroy_timer(self._checks)
        for subscription in self._infos:
            subscription.close()
        self.configuration, self._checks, self._infos = None, None, []

    def close(self) -> None:
        """End self-tests and publishers of a node that is cleaned up, because it stops."""
        self.context.self_test.close()
        self.context.outputs.close()

    def offer(self, ns: int, pair: Callable[[int], StereoPair]) -> None:
        """Queue a pair that has arrived; see :meth:`.measuring_thread.MeasuringThread.offer`."""
        if self.thread is not None:
            self.thread.offer(ns, pair)

    def on_boxes(self, thread: MeasuringThread, msg: PointCloud2) -> None:
        """Queue the boxes that another node found in a left image."""
        try:
            thread.offer_boxes(stamp_ns(msg.header.stamp), boxes_from_message(msg))
        except InputError as error:
            self.context.refusals.add(BOXES_TOPIC, error)

    def check(self, calibration: CalibrationWatch) -> None:
        """
        Raise the error that ended the measuring thread; poll calibrations, workers, self-test.

        :raises StereoSpeedError: the site cannot be used with this rig.
        """
        context = self.context
        if self.thread is not None and self.thread.failure is not None:
            raise self.thread.failure
        calibration.settle()
        context.workers.revive()
        context.self_test.poll()
        context.outputs.tell_self_test(context.self_test.newest)

    def state(self) -> State:
        """Return the state of the measurement for ``/diagnostics``."""
        if self.thread is not None and self.thread.active:
            return self.thread.state()
        state = State('measuring')
        state.find(WARN, 'not configured' if self.configuration is None else 'inactive')
        return state

    def stamps(self) -> State:
        """Return the state of the stamps for ``/diagnostics``."""
        return State(STAMPS_UNKNOWN) if self.thread is None else self.thread.stamps()
