# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A listener that records everything that the live nodes publish, with the time of arrival."""
from __future__ import annotations

from dataclasses import dataclass, field
import json
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from .common import LATCHED, RELIABLE, stamp_ns
from .graph_listener import GraphListener


@dataclass(frozen=True)
class HeardReading:
    """
    A live speed.

    :param at_s: steady time of its arrival, s.
    :param ns: stamp of the pair, ns.
    :param frame_id: frame of the vehicle.
    :param speed_mps: speed of the vehicle, m/s.
    :param std_mps: 1-sigma of the speed, m/s.
    """

    at_s: float
    ns: int
    frame_id: str
    speed_mps: float
    std_mps: float


@dataclass
class Heard:
    """
    Everything that was received.

    :param readings: live speeds.
    :param passes: passes, decoded from JSON.
    :param places: stamp and vehicle to the place (x, y, z) in the left optical frame, m.
    :param levels: steady time, name, level and message of every diagnostic status.
    :param begun_s: steady time at which the replay was first heard; 0 before.
    :param begun_ns: stamp of the bag that was played then.
    """

    readings: list[HeardReading] = field(default_factory=list)
    passes: list[dict[str, Any]] = field(default_factory=list)
    places: dict[tuple[int, str], tuple[float, float, float]] = field(default_factory=dict)
    levels: list[tuple[float, str, int, str]] = field(default_factory=list)
    begun_s: float = 0.0
    begun_ns: int = 0


class FaultListener(GraphListener):
    """Listens on a context of its own until it is closed, and fills ``heard``."""

    def __init__(self) -> None:
        super().__init__('fault_listener')
        self.heard = Heard()
        for kind, topic, callback, qos in (
                (TwistWithCovarianceStamped, '/vehicle_speed', self._reading, RELIABLE),
                (Odometry, '/tracks', self._track, RELIABLE),
                (String, '/passes', self._pass, LATCHED),
                (DiagnosticArray, '/diagnostics', self._status, 10),
                (Clock, '/clock', self._clock, 10)):
            self.node.create_subscription(kind, topic, callback, qos)

    def _reading(self, msg: TwistWithCovarianceStamped) -> None:
        self.heard.readings.append(HeardReading(
            time.monotonic(), stamp_ns(msg.header.stamp), msg.header.frame_id,
            msg.twist.twist.linear.x, msg.twist.covariance[0] ** 0.5))

    def _track(self, msg: Odometry) -> None:
        p = msg.pose.pose.position
        self.heard.places[stamp_ns(msg.header.stamp), msg.child_frame_id] = (p.x, p.y, p.z)

    def _pass(self, msg: String) -> None:
        self.heard.passes.append(json.loads(msg.data))

    def _clock(self, msg: Clock) -> None:
        if not self.heard.begun_s:
            self.heard.begun_s, self.heard.begun_ns = time.monotonic(), stamp_ns(msg.clock)

    def _status(self, msg: DiagnosticArray) -> None:
        self.heard.levels += [(time.monotonic(), s.name, ord(s.level), s.message)
                              for s in msg.status]
