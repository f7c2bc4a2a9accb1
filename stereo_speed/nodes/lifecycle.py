# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The lifecycle of the measuring nodes.

With ``autostart``, the default, a node configures and activates itself, so that ``ros2 run`` is
enough. Otherwise a lifecycle manager, or ``ros2 lifecycle set``, does so.
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
    Base class of the measuring nodes; a subclass subscribes to the input.

    In the unconfigured state it has its parameters and publishers; in the inactive state it has
    read the site and subscribes to calibrations; in the active state it measures. If a transition
    fails, the state does not change, and the error is logged.

    :param name: name of the node.
    :param speeds: whether to publish ``vehicle_speed`` too.
    :param helpers: its helper processes; None to start them when they are needed.
    """

    def __init__(self, name: str, *, speeds: bool = False, helpers: Optional[Helpers] = None
                 ) -> None:
        super().__init__(name)
        self.p, self.diagnostics = Parameters(self), Diagnostics(self)
        self.autostart: bool = self.p.get(
            'autostart', True, 'configure and activate at the start; false to wait for a '
            'lifecycle manager')
        self.measuring = Measuring(self, self.p, Outputs(self, self.p, speeds=speeds),
                                   helpers)
        self.diagnostics.tasks.update(self.measuring.tasks)
        # For a transition that is not possible in the present state, rclpy raises, which would
        # end the node.
        self._change = self._service_change_state.callback
        self._service_change_state.callback = self.on_change_state
        self._starting = False
        self._error: Optional[Exception] = None  # error of the newest transition

    def subscribe(self) -> None:
        """Subscribe to the input."""
        raise NotImplementedError

    def unsubscribe(self) -> None:
        """Unsubscribe from the input, if subscribed."""
        raise NotImplementedError

    def activate(self) -> None:
        """Begin to measure; input that arrives while kernels are loaded waits in its queue."""
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
        """End the passes, and discard the configuration."""
        self.deactivate()
        self.measuring.cleanup()

    def close(self) -> None:
        """End everything, because the node stops."""
        self.forget()
        self.measuring.close()

    def begin(self) -> None:
        """
        Configure and activate, unless that is left to a manager.

        :raises StereoSpeedError: the configuration cannot be used.
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
        """Make the requested transition, if it is possible in the present state."""
        try:
            return self._change(request, response)
        except rclpy_implementation.RCLError as error:
            self.get_logger().warning(f'transition refused: {error}')
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
        """End everything."""
        return self._tried(self.close)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Return to the unconfigured state after an internal error, which stays known."""
        error = self._error
        done = self._tried(self.forget)
        self._error = error
        return done

    def _tried(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        """Do the work of a transition and log its errors, which rclpy itself would hide."""
        self._error = None
        try:
            work()
        except Exception as error:
            self._error = error
            if not self._starting:  # otherwise the error ends the node and is printed then
                self.get_logger().error(f'{error}' if isinstance(error, StereoSpeedError)
                                        else repr(error))
            return TransitionCallbackReturn.FAILURE if isinstance(error, StereoSpeedError) \
                else TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS


def run_measuring(kind: type[MeasuringNode], helpers: Helpers, args: Sequence[str]) -> int:
    """
    Run a measuring node until it is told to stop; return its exit status as ``run`` does.

    :param kind: class of the node.
    :param helpers: helper processes of the node.
    :param args: command line.
    """
    return run(partial(kind, helpers=helpers), args)
