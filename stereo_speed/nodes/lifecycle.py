# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The lifecycle of the nodes that measure.

``ros2 run`` alone measures: with ``autostart``, the default, a node configures and activates
itself. Without it a lifecycle manager, or ``ros2 lifecycle set``, does so.
"""
from __future__ import annotations

from functools import partial
from typing import Callable, Optional, Sequence

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from .common import Parameters, run
from .diagnostics import Diagnostics
from .helpers import Helpers
from .measuring import Measuring
from .outputs import Outputs
from ..core.errors import StereoSpeedError


class MeasuringNode(LifecycleNode):
    """
    A node that measures, by what a subclass subscribes to.

    Unconfigured it has its parameters and publishers; inactive it has read the site and listens
    for calibrations; active it measures. Where a transition fails the state stays as it is, and
    the error is logged.

    :param name: of the node.
    :param speeds: publish ``vehicle_speed`` too.
    :param helpers: processes that were made for it.
    """

    def __init__(self, name: str, *, speeds: bool = False, helpers: Optional[Helpers] = None
                 ) -> None:
        super().__init__(name)
        self.p, self.diagnostics = Parameters(self), Diagnostics(self)
        self.autostart: bool = self.p.get(
            'autostart', True, 'configure and activate at the start; false waits until a '
            'lifecycle manager does')
        self.measuring = Measuring(self, self.p, Outputs(self, self.p, speeds=speeds),
                                   helpers)
        self.diagnostics.tasks.update(self.measuring.tasks)
        # Asked for a transition that the present state has not, rclpy raises, which ends the node.
        self._change = self._service_change_state.callback
        self._service_change_state.callback = self.on_change_state
        self._starting = False
        self._error: Optional[Exception] = None  # of the newest transition

    def subscribe(self) -> None:
        """Begin to listen for what is measured."""
        raise NotImplementedError

    def unsubscribe(self) -> None:
        """Listen no more; nothing is done where nothing was listened for."""
        raise NotImplementedError

    def activate(self) -> None:
        """Measure what comes; what does so while kernels are loaded waits in its queue."""
        self.subscribe()
        try:
            self.measuring.activate()
        except StereoSpeedError:
            self.unsubscribe()
            raise

    def deactivate(self) -> None:
        """End the passes that are still open."""
        self.unsubscribe()
        self.measuring.deactivate()

    def forget(self) -> None:
        """End the passes, and forget what was configured."""
        self.deactivate()
        self.measuring.cleanup()

    def close(self) -> None:
        """End whatever is under way: the node stops."""
        self.forget()
        self.measuring.self_test.close()

    def begin(self) -> None:
        """
        Configure and activate, where that is not left to a manager.

        :raises StereoSpeedError: what is configured cannot be used.
        """
        if not self.autostart:
            return
        self._starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() is not TransitionCallbackReturn.SUCCESS:
                raise self._error or RuntimeError(f'{self.get_name()} could not be started')
        self._starting = False

    def on_change_state(self, request: ChangeState.Request, response: ChangeState.Response
                        ) -> ChangeState.Response:
        """Make the transition that is asked for, if the present state has it."""
        try:
            return self._change(request, response)
        except rclpy_implementation.RCLError as error:
            self.get_logger().warning(f'refused: {error}')
            response.success = False
            return response

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure."""
        return self._tried(self.measuring.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate."""
        return self._tried(self.activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate."""
        return self._tried(self.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up."""
        return self._tried(self.measuring.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End whatever is under way."""
        return self._tried(self.close)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go back to the beginning after a fault of ours, which stays known."""
        error = self._error
        done = self._tried(self.forget)
        self._error = error
        return done

    def _tried(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        """Do the work of a transition; rclpy itself would hide what it raises."""
        self._error = None
        try:
            work()
        except Exception as error:
            self._error = error
            if not self._starting:  # else it ends the node, which says it
                self.get_logger().error(f'{error}' if isinstance(error, StereoSpeedError)
                                        else repr(error))
            return TransitionCallbackReturn.FAILURE if isinstance(error, StereoSpeedError) \
                else TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS


def run_measuring(kind: type[MeasuringNode], helpers: Helpers, args: Sequence[str]) -> int:
    """
    Run a node that measures until it is told to stop; return its exit status, as of ``run``.

    :param kind: its class.
    :param helpers: processes that were made for it.
    :param args: command line.
    """
    return run(partial(kind, helpers=helpers), args)
