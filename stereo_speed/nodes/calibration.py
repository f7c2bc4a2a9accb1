# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The rig from both ``camera_info`` topics, robust to faulty messages.

A message that is not a calibration is refused. A calibration that differs from the known one is
accepted once it has been repeated, or not been contradicted for some time. Until then, or until
the known one arrives again, nothing is measured.

Only the thread of the node processes messages; the measuring thread only reads.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import time
from typing import Any, Callable, Optional

from .health import ERROR, Refusals, State, WARN
from ..core.errors import CalibrationError
from ..geometry.rig import StereoRig
from ..io.camera_info import camera_from_info, rig_from_info, same_calibration

_REPEATED = 3
_UNCONTRADICTED_S = 1.0
_PATIENCE_S = 5.0  # time to wait for the first calibrations
_IN_TURN, _IN_TURN_S = 5, 10.0  # changes within a time; a faulty message makes two of them


@dataclass
class _Candidate:
    """A calibration that differs from the known one, its first arrival and count."""

    msg: Any
    since_s: float
    count: int = 1


class CalibrationWatch:
    """
    See the module's docstring.

    ``current`` is the number of changes so far and the rig, which is None until both cameras are
    known, or if they make no valid rig.

    :param refusals: counts refused messages.
    :param clock: steady time, s.
    """

    def __init__(self, refusals: Refusals, clock: Callable[[], float] = time.monotonic) -> None:
        self.current: tuple[int, Optional[StereoRig]] = (0, None)
        self._refusals, self._clock, self._begun_s = refusals, clock, clock()
        self._known: dict[str, Any] = {}
        self._others: dict[str, _Candidate] = {}
        self._fault = ''
        self._newest: dict[str, Any] = {}
        self._changed_s: dict[str, deque[float]] = {}  # times of the last changes, by side

    @property
    def doubtful(self) -> bool:
        """Return whether another calibration has arrived that is not yet accepted."""
        return bool(self._others)

    def holds(self, version: int) -> bool:
        """Return whether the rig of a version is certainly the present one."""
        # In this order, because ``current`` is updated before the doubt is cleared.
        return not self.doubtful and self.current[0] == version

    def take(self, side: str, msg: Any) -> None:
        """Process a message of a side."""
        topic = f'{side}/camera_info'
        try:
            camera_from_info(msg, side, topic)
        except CalibrationError as error:
            self._refusals.add(topic, error)
            return
        self._note_change(side, msg)
        known, other = self._known.get(side), self._others.get(side)
        if known is None:
            self._known[side] = msg
            self._make()
        elif same_calibration(known, msg):
            self._others.pop(side, None)
        elif other is not None and same_calibration(other.msg, msg):
            other.count += 1
        else:
            self._others[side] = _Candidate(msg, self._clock())
            self._refusals.add(topic, CalibrationError(
                topic, 'calibration', 'a different one', 'the one in use; nothing is measured '
                'until one of the two is confirmed'))
        self.settle()

    def _note_change(self, side: str, msg: Any) -> None:
        """Note when a message of a side differs from the one before it."""
        before, self._newest[side] = self._newest.get(side, msg), msg
        if not same_calibration(before, msg):
            self._changed_s.setdefault(side, deque(maxlen=_IN_TURN)).append(self._clock())

    def settle(self) -> None:
        """Accept other calibrations once all of them are confirmed, both sides at once."""
        now_s = self._clock()
        if self._others and all(
                other.count >= _REPEATED or now_s - other.since_s > _UNCONTRADICTED_S
                for other in self._others.values()):
            self._known.update((side, other.msg) for side, other in self._others.items())
            self._make()
            self._others.clear()

    def _make(self) -> None:
        if len(self._known) < 2:
            return
        rig: Optional[StereoRig] = None
        self._fault = ''
        try:
            rig = rig_from_info(self._known['left'], self._known['right'], 'camera_info')
        except CalibrationError as error:
            self._fault = str(error)
            self._refusals.add('camera_info', error)
        self.current = (self.current[0] + 1, rig)

    def tell(self, state: State) -> None:
        """Add faults of the calibration to a state."""
        if self._fault:
            state.find(ERROR, self._fault)
        elif self.current[1] is None:
            missing = ' and '.join(f'{side}/camera_info' for side in ('left', 'right')
                                   if side not in self._known)
            late = self._clock() - self._begun_s > _PATIENCE_S
            state.find(ERROR if late else WARN, f'waiting for {missing}')
        elif self._in_turn():
            state.find(ERROR, 'different calibrations arrive in turn: pairs are withheld between '
                       'them')
        elif self.doubtful:  # for about a second, unless they go on to change
            state.find(WARN, 'a different calibration has arrived: nothing is measured until it '
                       'is confirmed')

    def _in_turn(self) -> bool:
        """Return whether a side gets several calibrations, as from two drivers."""
        now_s = self._clock()
        return any(len(times_s) == _IN_TURN and now_s - times_s[0] < _IN_TURN_S
                   for times_s in self._changed_s.values())
