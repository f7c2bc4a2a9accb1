# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Live data for a page: readings, passes, overlays, and the state of each node.

A listener to the ROS graph adds data from any thread; pages read snapshots.
"""
from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass, field
import threading
import time
from typing import Any, Callable, Optional

STALE_S = 2.0  # time without a message after which the shown data are stale
KEPT_READINGS, KEPT_PASSES = 600, 200


@dataclass(frozen=True)
class LiveReading:
    """
    One speed of one vehicle.

    :param track: name of the track, such as ``vehicle_3``.
    :param stamp_ns: stamp of the pair.
    :param speed_mps: speed.
    :param std_mps: its 1-sigma.
    """

    track: str
    stamp_ns: int
    speed_mps: float
    std_mps: float


@dataclass(frozen=True)
class LiveHealth:
    """
    A diagnostic status of a node.

    :param name: name of the node and its part.
    :param level: 0 good, 1 warning, 2 error, 3 stale.
    :param message: text of the status.
    :param values: further values, as text.
    """

    name: str
    level: int
    message: str
    values: dict[str, str] = field(default_factory=dict)


class LiveState:
    """
    The latest live data.

    :param clock: returns the time in s, for the age of data.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._lock = clock, threading.Lock()
        self._number = 0
        self._readings: deque[tuple[float, LiveReading]] = deque(maxlen=KEPT_READINGS)
        self._passes: deque[dict[str, Any]] = deque(maxlen=KEPT_PASSES)
        self._health: dict[str, tuple[float, LiveHealth]] = {}
        self._overlays: dict[str, tuple[float, bytes]] = {}
        self._last: Optional[float] = None

    def add_reading(self, reading: LiveReading) -> None:
        """Add a speed."""
        with self._lock:
            self._readings.append((self._clock(), reading))
            self._touch()

    def add_pass(self, result: dict[str, Any]) -> None:
        """Add a finished pass, with the columns of ``passes.csv``."""
        with self._lock:
            self._passes.append(dict(result))
            self._touch()

    def add_health(self, health: LiveHealth) -> None:
        """Add a diagnostic status of a node."""
        with self._lock:
            self._health[health.name] = self._clock(), health
            self._number += 1

    def add_image(self, view: str, jpeg: bytes) -> None:
        """
        Add an annotated image.

        :param view: ``left`` or ``right``.
        :param jpeg: the image.
        """
        with self._lock:
            self._overlays[view] = self._clock(), jpeg
            self._touch()

    def _touch(self) -> None:
        self._number += 1
        self._last = self._clock()

    def overlay(self, view: str) -> Optional[bytes]:
        """Return the newest image of a view; None before the first."""
        with self._lock:
            return self._overlays[view][1] if view in self._overlays else None

    def snapshot(self) -> dict[str, Any]:
        """Return all data in the form that pages use."""
        with self._lock:
            now = self._clock()
            age = None if self._last is None else now - self._last
            return {
                'number': self._number, 'age_s': age, 'stale': age is None or age > STALE_S,
                'stale_after_s': STALE_S,
                'views': {view: now - self._overlays[view][0] for view in sorted(self._overlays)},
                'readings': [{**asdict(reading), 'age_s': now - at}
                             for at, reading in self._readings],
                'passes': list(self._passes),
                'health': [{**asdict(health), 'age_s': now - at}
                           for at, health in self._health.values()]}
