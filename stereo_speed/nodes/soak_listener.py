# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A listener for the tracks of every pair and every pass, for hours, with little memory."""
from __future__ import annotations

import json
from typing import Any, Callable

from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import String

from .common import LATCHED, RELIABLE, stamp_ns
from .delay_listener import DelayListener

Place = tuple[int, tuple[float, float, float]]  # stamp ns; x, y, z in the left optical frame, m


class SoakListener(DelayListener):
    """
    Listens on a context of its own until it is closed.

    :param on_pass: called with each pass, decoded from JSON, and the places of its track.
    """

    def __init__(self, on_pass: Callable[[dict[str, Any], list[Place]], None]) -> None:
        super().__init__('soak_listener')
        self._on_pass = on_pass
        self._places: dict[int, list[Place]] = {}
        self.pairs_ns: list[int] = []
        self.delays_s: list[float] = []  # times from sending a pair to its tracks
        self.reading_delays_s: list[float] = []
        self.readings = 0
        for kind, topic, callback, qos in (
                (TwistWithCovarianceStamped, '/vehicle_speed', self._reading, RELIABLE),
                (Odometry, '/tracks', self._track, RELIABLE),
                (String, '/track_states', self._pair, RELIABLE),
                (String, '/passes', self._pass, LATCHED)):
            self.node.create_subscription(kind, topic, callback, qos)

    def _reading(self, msg: TwistWithCovarianceStamped) -> None:
        self.readings += 1
        delay_s = self.delay_s(stamp_ns(msg.header.stamp))
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
        self._on_pass(told, self._places.pop(int(told['track']), []))
