# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A user's node that takes down everything the live nodes say, and when."""
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

    :param at_s: steady time at which it came.
    :param ns: stamp of the pair.
    :param frame_id: names the vehicle.
    :param speed_mps: its speed.
    :param std_mps: 1-sigma of that.
    """

    at_s: float
    ns: int
    frame_id: str
    speed_mps: float
    std_mps: float


@dataclass
class Heard:
    """
    All that was said.

    :param readings: live speeds.
    :param passes: as read from their JSON.
    :param places: stamp and vehicle to the place (x, y, z) in the left optical frame, m.
    :param levels: steady time, name, level and message of every status.
    :param begun_s: steady time at which the replay began; 0 before.
    """

    readings: list[HeardReading] = field(default_factory=list)
    passes: list[dict[str, Any]] = field(default_factory=list)
    places: dict[tuple[int, str], tuple[float, float, float]] = field(default_factory=dict)
    levels: list[tuple[float, str, int, str]] = field(default_factory=list)
    begun_s: float = 0.0


class FaultListener(GraphListener):
    """Listens on a context of its own until it is closed; ``heard`` has it all."""

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
        self.heard.begun_s = self.heard.begun_s or time.monotonic()

    def _status(self, msg: DiagnosticArray) -> None:
        self.heard.levels += [(time.monotonic(), s.name, ord(s.level), s.message)
                              for s in msg.status]
