# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``log_node``: writes passes and readings into an SQLite file, crash-safe."""
from __future__ import annotations

from collections import deque
from functools import partial
import math
from pathlib import Path
import sqlite3

from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import String

from .common import (
    LAST_S, LATCHED, latched_options, Parameters, qos_options, receive_last, RELIABLE, run,
    stamp_ns)
from .diagnostics import Diagnostics
from .health import ERROR, State
from .speeds import speed_of
from ..core.errors import InputError
from ..io.pass_log import PassLog


_MOST_UNWRITTEN = 10000  # greatest number of passes that wait for a disk that can be written


class LogNode(Node):
    """
    Writes every pass of ``passes``, and every state of ``tracks``, into an SQLite file.

    A pass is on the disk as soon as it has arrived; readings are synced every ``sync_s``.  While
    the disk cannot be written, ``/diagnostics`` has an ERROR, and passes wait until it can.
    """

    def __init__(self) -> None:
        super().__init__('log_node')
        p = Parameters(self)
        path = p.get('file', 'passes.sqlite', 'SQLite file; an existing one is appended to')
        sync_s = p.get('sync_s', 1.0, 'interval at which readings are synced to the disk [s]',
                       0.05, 3600.0)
        self.log = PassLog(Path(path).expanduser())
        self.passes = self.tracks = self.refused = self.lost_passes = self.lost_readings = 0
        self.fault = ''
        self.unwritten: deque[str] = deque()  # texts of passes
        self._passes = self.create_subscription(String, 'passes', self.on_pass, LATCHED,
                                                qos_overriding_options=latched_options())
        self.create_subscription(Odometry, 'tracks', self.on_track, RELIABLE,
                                 qos_overriding_options=qos_options())
        # Steady time, because simulated time stops with the images.
        self.create_timer(sync_s, self.sync, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.diagnostics = Diagnostics(self, {'log': self.state})

    def on_pass(self, msg: String) -> None:
        """Write a pass, unless it is in the file: the topic repeats recent ones."""
        self.unwritten.append(msg.data)
        if len(self.unwritten) > _MOST_UNWRITTEN:
            self.unwritten.popleft()
            self.lost_passes += 1
            self.get_logger().error(f'the oldest of {_MOST_UNWRITTEN} passes that wait for the '
                                    'disk is lost', throttle_duration_sec=10.0)
        self._write_passes()

    def _write_passes(self) -> None:
        """Write the passes that wait, oldest first, until all are written or the disk fails."""
        while self.unwritten:
            try:
                self.passes += self.log.add_pass(self.unwritten[0])
                self.fault = ''
            except InputError as error:
                self.refused += 1
                self.get_logger().error(str(error))
            except sqlite3.Error as error:
                self.failed(error)
                return
            self.unwritten.popleft()

    def on_track(self, track: Odometry) -> None:
        """Write a state of a track, with a speed only if it is a measurement."""
        speed, at = speed_of(track), track.pose.pose.position
        try:
            self.log.add_track(stamp_ns(track.header.stamp), track.child_frame_id,
                               None if speed is None else speed.twist.twist.linear.x,
                               None if speed is None else math.sqrt(
                                   speed.twist.covariance[0]), (at.x, at.y, at.z))
            self.tracks += 1
        except sqlite3.Error as error:
            self.lost_readings += 1
            self.failed(error)

    def sync(self) -> None:
        """Sync new data to the disk, which can be written again once this succeeds."""
        try:
            if self.log.keep() and not self.unwritten:
                self.fault = ''
        except sqlite3.Error as error:
            self.failed(error)
            return
        self._write_passes()

    def failed(self, error: sqlite3.Error) -> None:
        """Report that nothing could be written."""
        self.fault = f'{self.log.path}: {error}'
        self.get_logger().error(self.fault, throttle_duration_sec=10.0)

    def state(self) -> State:
        """Return level and counts for ``/diagnostics``."""
        state = State('logging', values={
            'file': str(self.log.path), 'passes': self.passes, 'tracks': self.tracks,
            'refused': self.refused, 'unwritten': len(self.unwritten),
            'lost_passes': self.lost_passes, 'lost_readings': self.lost_readings})
        if self.fault:
            state.find(ERROR, self.fault)
        return state

    def close(self) -> None:
        """Write the passes that nodes publish as they end with this one, and close the file."""
        receive_last(self, [self._passes], LAST_S)
        self.sync()
        try:
            self.log.close()
        except sqlite3.Error as error:
            self.failed(error)
        if self.fault:
            self.get_logger().error(f'{self.fault}; {len(self.unwritten)} passes are not written')


main = partial(run, LogNode)

if __name__ == '__main__':
    raise SystemExit(main())
