# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``faulty_replay_node``: plays a bag as a faulty camera pair would.

It serves to test the reaction of the live nodes. The fault begins at ``fault_start`` seconds of
the bag and lasts for ``fault_length``; ``docs/live.md`` lists the faults and their effects.
"""
from __future__ import annotations

from array import array
from copy import deepcopy
from functools import partial
import time
from typing import Any, Callable, Optional, Sequence

import numpy as np
from sensor_msgs.msg import CameraInfo

from .common import Parameters, run, stamp_ns, to_stamp
from .replay_node import ReplayNode
from ..core.errors import InputError

Sent = Sequence[tuple[str, Any]]  # side and message
Fault = Callable[['FaultyReplayNode', str, Any], Sent]


class FaultyReplayNode(ReplayNode):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__('faulty_replay_node')
        p = Parameters(self)
        self.fault = p.get('fault', 'none', 'fault of the stream: ' + ', '.join(FAULTS))
        self.begins_s = p.get('fault_start', 5.0, 'start of the fault [s]', 0.0, 1e9)
        self.ends_s = self.begins_s + p.get('fault_length', 3.0, 'length of the fault [s]',
                                            0.0, 1e9)
        self.plays_s = p.get('length', 1e9, 'seconds of the bag that are played', 0.0, 1e9)
        self.exposures = p.get('exposures', 2, 'for exposed_apart: number of exposures in the bag '
                               'for each image of a camera', 2, 1000)
        if self.fault not in FAULTS:
            raise InputError(f'{self.get_name()}: parameter', 'fault', self.fault,
                             ', '.join(FAULTS))
        self.rng = np.random.default_rng(0)
        self.kept: dict[Any, Any] = {}
        self.spoilt = False

    def send(self, side: str, kind: str, msg: Any, due_s: float) -> None:
        """Publish a message with the fault applied."""
        if due_s > self.plays_s:
            return
        of, change = FAULTS[self.fault]
        if of != kind or not self.begins_s <= due_s < self.ends_s:
            self.outputs[side, kind].publish(msg)
            return
        for to, sent in change(self, side, msg):
            self.outputs[to, kind].publish(sent)


def _once(change: Callable[[Any], None]) -> Fault:
    """Return a fault that changes one message of the left side."""
    def fault(node: FaultyReplayNode, of: str, msg: Any) -> Sent:
        if of == 'left' and not node.spoilt:
            node.spoilt = True
            change(msg)
        return [(of, msg)]
    return fault


def _once_of_both(change: Callable[[Any], None]) -> Fault:
    """Return a fault that changes one message of each side, of the same pair."""
    def fault(node: FaultyReplayNode, of: str, msg: Any) -> Sent:
        if node.kept.setdefault('spoilt', stamp_ns(msg.header.stamp)) == stamp_ns(
                msg.header.stamp):
            change(msg)
        return [(of, msg)]
    return fault


def _each(change: Callable[[Any], None], sides: Sequence[str] = ('left', 'right')) -> Fault:
    """Return a fault that changes every message of some sides."""
    def fault(node: FaultyReplayNode, of: str, msg: Any) -> Sent:
        if of in sides:
            change(msg)
        return [(of, msg)]
    return fault


def _later(seconds: float) -> Callable[[Any], None]:
    """Return a change that shifts a stamp."""
    def change(msg: Any) -> None:
        msg.header.stamp = to_stamp(stamp_ns(msg.header.stamp) + round(seconds * 1e9))
    return change


def _with(field: str, value: object) -> Callable[[Any], None]:
    """Return a change that gives a field another value."""
    return lambda msg: setattr(msg, field, value)


def _jitter(node: FaultyReplayNode, of: str, msg: Any) -> Sent:
    """Shift the stamps of both images of a pair by the same random delay of some ms."""
    ns = stamp_ns(msg.header.stamp)
    late_s = node.kept.setdefault(ns, abs(float(node.rng.normal(0.0, 0.005))))
    _later(late_s)(msg)
    return [(of, msg)]


def _delayed(node: FaultyReplayNode, of: str, msg: Any) -> Sent:
    """Send right images 50 ms late, with unchanged stamps."""
    if of == 'right':
        time.sleep(0.05)
    return [(of, msg)]


def _apart(node: FaultyReplayNode, of: str, msg: Any) -> Sent:
    """Send a left image and the right one of the next exposure, as cameras without a trigger."""
    seen = node.kept[of] = node.kept.get(of, -1) + 1
    return [(of, msg)] if seen % node.exposures == (0 if of == 'left' else 1) else []


def _stamp_of_zero(msg: Any) -> None:
    msg.header.stamp = to_stamp(0)


def _short(msg: Any) -> None:
    msg.data = array('B', bytes(msg.data[:len(msg.data) // 2]))


def _other_size(msg: Any) -> None:
    msg.height //= 2
    msg.data = array('B', bytes(msg.data[:msg.height * msg.step]))


def _empty(msg: Any) -> None:
    msg.height = msg.width = msg.step = 0
    msg.data = array('B')


def _float(msg: Any) -> None:
    pixels = np.frombuffer(bytes(msg.data), np.uint8).astype(np.float32)
    msg.encoding, msg.step, msg.data = '32FC1', 4 * msg.width, array('B', pixels.tobytes())


def _black(msg: Any) -> None:
    msg.data = array('B', bytes(len(msg.data)))


def _longer(msg: CameraInfo) -> None:
    msg.k = np.asarray(msg.k) * np.array([1.01, 1, 1, 1, 1.01, 1, 1, 1, 1])


def _lost(sides: Sequence[str], share: float = 1.0) -> Fault:
    """Return a fault that drops a share of the messages of some sides."""
    def fault(node: FaultyReplayNode, of: str, msg: Any) -> Sent:
        return [] if of in sides and node.rng.random() < share else [(of, msg)]
    return fault


def _frozen(sides: Sequence[str]) -> Fault:
    """Return a fault that repeats the same pixels."""
    def fault(node: FaultyReplayNode, of: str, msg: Any) -> Sent:
        if of in sides:
            msg.data = node.kept.setdefault(of, msg).data
        return [(of, msg)]
    return fault


def _swapped(node: FaultyReplayNode, of: str, msg: Any) -> Sent:
    return [('right' if of == 'left' else 'left', msg)]


def _twice(node: FaultyReplayNode, of: str, msg: Any) -> Sent:
    return [(of, msg), (of, msg)]


def _disordered(node: FaultyReplayNode, of: str, msg: Any) -> Sent:
    """Swap the order of each two right images."""
    if of == 'left':
        return [(of, msg)]
    before: Optional[Any] = node.kept.pop(of, None)
    if before is None:
        node.kept[of] = deepcopy(msg)
        return []
    return [(of, msg), (of, before)]


_RIGHT, _BOTH = ('right',), ('left', 'right')
FAULTS: dict[str, tuple[str, Fault]] = {
    'none': ('image', _each(lambda msg: None)),
    'short_data': ('image', _once(_short)),
    'other_size': ('image', _once(_other_size)),
    'no_size': ('image', _once(_empty)),
    'odd_encoding': ('image', _once(_with('encoding', 'yuv422'))),
    'float_encoding': ('image', _once(_float)),
    'black': ('image', _each(_black)),
    'frozen_pair': ('image', _frozen(_BOTH)),
    'frozen_right': ('image', _frozen(_RIGHT)),
    'swapped': ('image', _swapped),
    'no_right': ('image', _lost(_RIGHT)),
    'no_images': ('image', _lost(_BOTH)),
    'lost_30_percent': ('image', _lost(_BOTH, 0.3)),
    'twice': ('image', _twice),
    'disordered': ('image', _disordered),
    'right_delayed': ('image', _delayed),
    'exposed_apart': ('image', _apart),
    'right_5_ms': ('image', _each(_later(0.005), _RIGHT)),
    'right_20_ms': ('image', _each(_later(0.02), _RIGHT)),
    'right_50_ms': ('image', _each(_later(0.05), _RIGHT)),
    'clock_30_ms_on': ('image', _each(_later(0.03))),
    'clock_30_ms_back': ('image', _each(_later(-0.03))),
    'clock_half_a_second_back': ('image', _each(_later(-0.5))),
    'clock_an_hour_on': ('image', _each(_later(3600.0))),
    'clock_an_hour_back': ('image', _each(_later(-3600.0))),
    'jitter': ('image', _jitter),
    'stamp_an_hour_on': ('image', _once(_later(3600.0))),
    'pair_an_hour_on': ('image', _once_of_both(_later(3600.0))),
    'stamp_of_zero': ('image', _once(_stamp_of_zero)),
    'stamps_of_zero': ('image', _each(_stamp_of_zero)),
    'info_nan': ('camera_info', _once(_with('k', np.full(9, np.nan)))),
    'info_uncalibrated': ('camera_info', _each(_with('k', np.zeros(9)))),
    'no_info': ('camera_info', _lost(_BOTH)),
    'info_other': ('camera_info', _each(_longer)),
}


main = partial(run, FaultyReplayNode, spin=FaultyReplayNode.play)

if __name__ == '__main__':
    raise SystemExit(main())
