# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The health of a node, without ROS: refused, arriving and missing messages.

Times are steady times of this machine, because only these tell how long nothing has arrived. A
fault affects the state for ``WINDOW_S``.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
import threading
import time
from typing import Callable, Optional, Union

import numpy as np
from numpy.typing import NDArray

OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'  # levels of DiagnosticStatus
WINDOW_S = 5.0
SILENT_S = 2.0  # silence that is an error if it also lasts for SILENT_INTERVALS
SILENT_INTERVALS = 5  # in multiples of the last interval between messages
_LOG_S = 1.0  # least time between two log lines about the same topic
NEIGHBOUR_START_S = 10.0  # a node is up in 5 s on a slow machine, and discovered within 3 s

Value = Union[int, float, str]


@dataclass
class State:
    """
    Level, message and values of one diagnostic task; the worst finding counts.

    :param fine: message if there are no findings.
    :param level: ``OK``, ``WARN`` or ``ERROR``.
    :param found: findings, each in a few words.
    :param values: further details.
    """

    fine: str
    level: bytes = OK
    found: list[str] = field(default_factory=list)
    values: dict[str, Value] = field(default_factory=dict)

    def find(self, level: bytes, message: str) -> None:
        """Add a finding."""
        self.level = max(self.level, level)
        self.found.append(message)

    @property
    def message(self) -> str:
        """Return the findings, or the message for the case that there are none."""
        return '; '.join(self.found) or self.fine


class Tally:
    """
    Counts events, in total and within ``WINDOW_S``.

    One thread may count while another one reads.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.total, self._clock, self._lock = 0, clock, threading.Lock()
        self._events: deque[tuple[float, int]] = deque()  # recent ones: time and count

    def add(self, count: int = 1) -> None:
        """Count events that happen now."""
        if not count:
            return
        with self._lock:
            self.total += count
            self._events.append((self._clock(), count))
            self._forget()

    def _forget(self) -> None:
        """Drop events older than ``WINDOW_S``, so that memory stays bounded."""
        since = self._clock() - WINDOW_S
        while self._events and self._events[0][0] < since:
            self._events.popleft()

    @property
    def recent(self) -> int:
        """Return the number of recent events."""
        with self._lock:
            self._forget()
            return sum(count for _, count in self._events)

    @property
    def rate_hz(self) -> float:
        """Return the rate of recent events, 1/s."""
        with self._lock:
            self._forget()
            if len(self._events) < 2:
                return 0.0
            span_s = self._events[-1][0] - self._events[0][0]
            count = sum(count for _, count in self._events) - self._events[0][1]
        return count / span_s if span_s > 0 else 0.0


class Refusals:
    """
    Counts messages that cannot be used, and logs them at most once a second for each topic.

    :param log: writes a warning.
    :param clock: steady time, s.
    """

    def __init__(self, log: Callable[[str], object],
                 clock: Callable[[], float] = time.monotonic) -> None:
        self._log, self._clock = log, clock
        self.tally = Tally(clock)
        self.last = ''
        self._logged_s: dict[str, float] = {}
        self._held_back: dict[str, int] = {}

    def add(self, topic: str, error: object) -> None:
        """
        Count a refused message.

        :param topic: topic of the message; the rate of log lines is limited for each topic alone.
        :param error: what was found and what was wanted.
        """
        self.tally.add()
        self.last, now_s = ' '.join(str(error).split()), self._clock()
        if now_s - self._logged_s.get(topic, -_LOG_S) < _LOG_S:
            self._held_back[topic] = self._held_back.get(topic, 0) + 1
            return
        more = self._held_back.pop(topic, 0)
        self._logged_s[topic] = now_s
        also = f' ({more} more since the last line)' if more else ''
        self._log(f'refused: {self.last}{also}')

    def tell(self, state: State) -> None:
        """Add refusals to a state."""
        state.values['refused'] = self.tally.total
        if self.last:
            state.values['last_refusal'] = self.last
        if self.tally.recent:
            state.find(WARN, f'{self.tally.recent} messages refused: {self.last}')


class StampGaps:
    """
    Counts the messages missing in a stream, by gaps in its stamps.

    The period is the lower quartile of the latest intervals, so that it is right as long as fewer
    than three of four neighbours are lost. Only gaps of whole periods count, because in a stream
    with uneven intervals missing messages cannot be counted.
    """

    _INTERVALS, _FEWEST = 40, 5
    _ODD = 0.25  # greatest deviation of a gap from a whole number of periods, in periods
    _LONGEST_NS = 30_000_000_000  # a longer gap is a step of the clock, or a pause

    def __init__(self) -> None:
        self._intervals_ns: deque[int] = deque(maxlen=self._INTERVALS)
        self._last_ns: Optional[int] = None

    def add(self, ns: int) -> int:
        """Add the next stamp; return how many are missing before it."""
        last_ns, self._last_ns = self._last_ns, ns
        if last_ns is None or ns <= last_ns:
            return 0
        step = ns - last_ns
        if step > self._LONGEST_NS:
            return 0
        period, known = self.period_ns, len(self._intervals_ns) >= self._FEWEST
        self._intervals_ns.append(step)
        if not known or not period:
            return 0
        periods = step / period
        whole = round(periods)
        return whole - 1 if whole > 1 and abs(periods - whole) < self._ODD else 0

    @property
    def period_ns(self) -> int:
        """Return the usual interval, ns; 0 while it is not known."""
        if not self._intervals_ns:
            return 0
        ordered = sorted(self._intervals_ns)  # for each image, so not by the slower np.quantile
        return ordered[round((len(ordered) - 1) * 0.25)]

    def restart(self) -> None:
        """Discard the last stamp, because time has jumped."""
        self._last_ns = None


class Repeats:
    """Detects an image that repeats the previous one: by every eighth pixel, then by all."""

    def __init__(self) -> None:
        self._last: Optional[NDArray[np.generic]] = None

    def add(self, grey: NDArray[np.generic]) -> bool:
        """Add an image (H, W); return whether it repeats the previous one."""
        last, self._last = self._last, grey
        return last is not None and last.shape == grey.shape and last.dtype == grey.dtype \
            and np.array_equal(_some(last), _some(grey)) and np.array_equal(last, grey)


def _some(grey: NDArray[np.generic]) -> NDArray[np.generic]:
    return grey[::8, ::8]


class Look:
    """Detects a camera whose images are frozen, black or without contrast."""

    _LEAST_S, _LEAST = 1.0, 3  # least duration of a fault, s and images
    _FLAT, _DARK = 2.0, 16.0  # least standard deviation and mean, of 255 grey levels

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._repeats = clock, Repeats()
        self._same_since: Optional[float] = None
        self._flat_since: Optional[float] = None
        self._same = self._flat = 0
        self._dark = False

    def add(self, grey: NDArray[np.generic]) -> None:
        """Add an image (H, W)."""
        now_s, same = self._clock(), self._repeats.add(grey)
        self._same, self._same_since = _run(same, self._same, self._same_since, now_s)
        levels = 255.0 / (255.0 if grey.itemsize == 1 else 65535.0)
        values = _some(grey).astype(np.float64) * levels
        self._dark = bool(values.mean() < self._DARK)
        flat = bool(values.std() < self._FLAT)
        self._flat, self._flat_since = _run(flat, self._flat, self._flat_since, now_s)

    def tell(self, state: State, side: str) -> None:
        """Add faults of the images to a state."""
        if self._lasts(self._flat, self._flat_since):  # first, as such images may be equal too
            state.find(ERROR, f'{side} images are {"black" if self._dark else "without contrast"}')
        elif self._lasts(self._same, self._same_since):
            state.find(ERROR, f'{side} images are frozen')

    def _lasts(self, count: int, since: Optional[float]) -> bool:
        return since is not None and count >= self._LEAST \
            and self._clock() - since > self._LEAST_S


def _run(goes_on: bool, count: int, since: Optional[float], now_s: float
         ) -> tuple[int, Optional[float]]:
    """Return for how many images a condition has held without a break, and since when."""
    if not goes_on:
        return 0, None
    return count + 1, now_s if since is None else since


class Arrivals:
    """Keeps the rate of arrivals and the time since the last one."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self.tally = clock, Tally(clock)
        self._since_s, self._last_s = clock(), 0.0
        self.interval_s = 0.0  # interval between the last two

    def add(self) -> None:
        """Count an arrival."""
        now_s = self._clock()
        if self.tally.total:
            self.interval_s = now_s - self._last_s
        self._last_s = now_s
        self.tally.add()

    @property
    def age_s(self) -> float:
        """Return the time since the last one, or since the start."""
        return self._clock() - (self._last_s if self.tally.total else self._since_s)

    @property
    def silent(self) -> bool:
        """Return whether arrivals have stopped, or never began."""
        return self.silent_for(SILENT_S)

    def silent_for(self, least_s: float) -> bool:
        """Return whether nothing arrived for this time and for ``SILENT_INTERVALS``."""
        return self.age_s > max(least_s, SILENT_INTERVALS * self.interval_s)

    def tell(self, state: State, what: str, key: str) -> None:
        """Add rate and age of arrivals to a state, and a finding if there are none."""
        state.values[f'{key}_hz'] = round(self.tally.rate_hz, 2)
        state.values[f'{key}_age_s'] = round(self.age_s, 3)
        if self.silent:
            state.find(ERROR, f'no {what} for {self.age_s:.0f} s')
        elif not self.tally.total:
            state.find(WARN, f'no {what} yet')


class Neighbours:
    """
    Detects that no node is at the other end of a topic.

    Nodes start in any order, so until one has been there, its absence is a finding only after
    ``NEIGHBOUR_START_S``.  After that it is one immediately.

    :param count: returns the number of nodes at the other end.
    :param clock: steady time, s.
    """

    def __init__(self, count: Callable[[], int],
                 clock: Callable[[], float] = time.monotonic) -> None:
        self._count, self._clock = count, clock
        self._since_s, self._seen = clock(), False

    def tell(self, state: State, level: bytes, message: str, key: str) -> None:
        """
        Add their number to a state, and a finding if there are none.

        :param level: level of the finding.
        :param message: text of the finding.
        :param key: name of the number.
        """
        count = state.values[key] = self._count()
        self._seen = self._seen or count > 0
        if not count and (self._seen or self._clock() - self._since_s > NEIGHBOUR_START_S):
            state.find(level, message)
