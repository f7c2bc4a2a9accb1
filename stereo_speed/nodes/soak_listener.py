# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A listener for the tracks of every pair and every pass, for hours, with little memory."""
from __future__ import annotations

import json
from typing import Any, Callable

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import String

from .common import LATCHED, RELIABLE, stamp_ns
from .delay_listener import DelayListener

Place = tuple[int, tuple[float, float, float]]  # stamp ns; x, y, z in the left optical frame, m
Reading = tuple[int, float, float]  # stamp ns; speed and its 1-sigma, m/s


class SoakListener(DelayListener):
    """
    Listens on a context of its own until it is closed.

    :param on_pass: called with each pass, decoded from JSON, and the places and the live readings
        of its track.

    ``skipped``, ``hurried`` and ``waiting`` are what the measuring node has last said of its pairs
    and of the passes under way.
    """

    def __init__(self, on_pass: Callable[[dict[str, Any], list[Place], list[Reading]], None]
                 ) -> None:
        super().__init__('soak_listener')
        self._on_pass = on_pass
        self._places: dict[int, list[Place]] = {}
        self._readings: dict[int, list[Reading]] = {}
        self.pairs_ns: list[int] = []
        self.delays_s: list[float] = []  # times from sending a pair to its tracks
        self.reading_delays_s: list[float] = []
        self.readings = self.skipped = self.hurried = self.waiting = 0
        for kind, topic, callback, qos in (
                (TwistWithCovarianceStamped, '/vehicle_speed', self._reading, RELIABLE),
                (Odometry, '/tracks', self._track, RELIABLE),
                (String, '/track_states', self._pair, RELIABLE),
                (String, '/passes', self._pass, LATCHED),
                (DiagnosticArray, '/diagnostics', self._status, 10)):
            self.node.create_subscription(kind, topic, callback, qos)

    def _reading(self, msg: TwistWithCovarianceStamped) -> None:
        self.readings += 1
        ns, track = stamp_ns(msg.header.stamp), int(msg.header.frame_id.rpartition('_')[2])
        self._readings.setdefault(track, []).append(
            (ns, msg.twist.twist.linear.x, msg.twist.covariance[0] ** 0.5))
        delay_s = self.delay_s(ns)
        if delay_s is not None:
            self.reading_delays_s.append(delay_s)

    def _track(self, msg: Odometry) -> None:
        p, track = msg.pose.pose.position, int(msg.child_frame_id.rpartition('_')[2])
        self._places.setdefault(track, []).append((stamp_ns(msg.header.stamp), (p.x, p.y, p.z)))

    def _pair(self, msg: String) -> None:
        ns = int(json.loads(msg.data)['stamp_ns'])
        self.pairs_ns.append(ns)
        delay_s = self.delay_s(ns)
        if delay_s is not None:
            self.delays_s.append(delay_s)
        self.forget_before(ns)

    def _pass(self, msg: String) -> None:
        told = json.loads(msg.data)
        track = int(told['track'])
        self._on_pass(told, self._places.pop(track, []), self._readings.pop(track, []))

    def _status(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            if status.name.endswith(': pipeline'):
                told = {value.key: value.value for value in status.values}
                if 'skipped' in told:  # not while the node has no pipeline
                    self.skipped = int(told['skipped']) + int(told['early'])
                self.hurried = int(told.get('hurried', self.hurried))
                self.waiting = int(told.get('passes_waiting', self.waiting))
