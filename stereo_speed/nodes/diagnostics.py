# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``/diagnostics``, by the conventions of ``diagnostic_updater``.

Each task has a status named ``NODE: TASK``, preceded by the node's namespace if there is one. It
is published once per ``diagnostic_updater.period``. ``hardware_id`` distinguishes rigs.
"""
from __future__ import annotations

from typing import Callable, Mapping, Optional

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from .common import Parameters
from .health import ERROR, State

Task = Callable[[], State]
_PERIOD_S = 1.0


class Diagnostics:
    """
    Publishes the states of a node's tasks on ``/diagnostics``.

    :param node: the node whose state is published.
    :param tasks: name of each task to the function that returns its state; more may be added.
    """

    def __init__(self, node: Node, tasks: Optional[Mapping[str, Task]] = None) -> None:
        p = Parameters(node)
        period_s = p.get('diagnostic_updater.period', _PERIOD_S, 'interval between states on '
                         '/diagnostics [s]', 0.1, 60.0)
        hardware = p.get('hardware_id', '', 'hardware_id of the states on /diagnostics; empty for '
                         'the namespace, or stereo_speed if there is none')
        namespace = node.get_namespace().strip('/')
        self.hardware_id = hardware or namespace or 'stereo_speed'
        self.prefix = f'{namespace}/{node.get_name()}' if namespace else node.get_name()
        self.node, self.tasks = node, dict(tasks or {})
        self.publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # Steady time, because with simulated time a stopped replay would stop the heartbeat too.
        node.create_timer(period_s, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Publish the present states."""
        msg = DiagnosticArray(status=[
            self._status(name, self._state(name, task)) for name, task in self.tasks.items()])
        msg.header.stamp = self.node.get_clock().now().to_msg()
        self.publisher.publish(msg)

    def _state(self, name: str, task: Task) -> State:
        """Return the state of a task; an internal error in computing it becomes its state."""
        try:
            return task()
        except Exception as error:
            state = State('')
            state.find(ERROR, f'cannot determine the state: {error!r}')
            self.node.get_logger().error(f'{name}: {state.message}', throttle_duration_sec=10.0)
            return state

    def _status(self, task: str, state: State) -> DiagnosticStatus:
        return DiagnosticStatus(
            level=state.level, name=f'{self.prefix}: {task}', message=state.message,
            hardware_id=self.hardware_id,
            values=[KeyValue(key=k, value=str(v)) for k, v in state.values.items()])
