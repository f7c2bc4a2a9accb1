# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Faults of cameras, transport and clocks, applied to a stream of simulated traffic.

They are those that ``faulty_replay_node`` applies to messages. Images pass through them one by
one, and are paired by their stamps as in the nodes. The nodes' own guards (against repeated images
and swapped views) are left out: the pipeline has to withstand the faults by itself.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Callable, Iterable, Iterator, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .traffic import TrafficPair
from ...core.pair_matcher import Match, PairMatcher
from ...core.records import StereoPair
from ...io.topics import SIDES

JUMP_NS = 1_000_000_000  # a stamp this far back is a restart of time, not a late image
LATE_TOLERANCE_NS = 60_000_000  # tolerance of the pairing for faults with late right stamps
_PAUSE_S, _MOST_S = 5.0, 2.0  # mean time between two episodes, longest episode


@dataclass(frozen=True, eq=False)
class SentImage:
    """
    An image in transit.

    :param side: ``left`` or ``right``.
    :param stamp_ns: its header stamp, which a fault may have changed.
    :param exposure: number of the exposure that it is sent for.
    :param pixels: (H, W), the image.
    """

    side: str
    stamp_ns: int
    exposure: int
    pixels: NDArray[Any]


@dataclass
class FaultState:
    """
    The state of a fault.

    :param rng: source of its randomness.
    :param kept: stored images, by side.
    :param begins: whether the fault starts with this exposure.
    """

    rng: np.random.Generator
    kept: dict[str, SentImage] = field(default_factory=dict)
    begins: bool = False


Fault = Callable[[FaultState, SentImage], Sequence[SentImage]]


@dataclass(frozen=True, eq=False)
class FaultyPair:
    """
    A pair as received through a fault.

    :param pair: the pair.
    :param exposure: number of the exposure that its left image was sent for.
    :param anew: whether time jumped back before it.
    """

    pair: StereoPair
    exposure: int
    anew: bool = False


def _sound(state: FaultState, image: SentImage) -> Sequence[SentImage]:
    return [image]


def _unusable(state: FaultState, image: SentImage) -> Sequence[SentImage]:
    """Drop one left image, as happens to one that cannot be decoded."""
    return [] if image.side == 'left' and state.begins else [image]


def _black(state: FaultState, image: SentImage) -> Sequence[SentImage]:
    return [replace(image, pixels=np.zeros_like(image.pixels))]


def _garbage(state: FaultState, image: SentImage) -> Sequence[SentImage]:
    if image.side == 'left':
        return [image]
    noise = state.rng.integers(0, 256, image.pixels.shape, dtype=np.uint8)
    return [replace(image, pixels=noise.astype(image.pixels.dtype))]


def _frozen(sides: Sequence[str]) -> Fault:
    """Return a fault that keeps sending the same pixels."""
    def fault(state: FaultState, image: SentImage) -> Sequence[SentImage]:
        if image.side not in sides:
            return [image]
        if state.begins:
            state.kept[image.side] = image
        return [replace(image, pixels=state.kept[image.side].pixels)]
    return fault


def _swapped(state: FaultState, image: SentImage) -> Sequence[SentImage]:
    return [replace(image, side='right' if image.side == 'left' else 'left')]


def _lost(sides: Sequence[str], share: float = 1.0) -> Fault:
    """Return a fault that drops a share of the images of some sides."""
    def fault(state: FaultState, image: SentImage) -> Sequence[SentImage]:
        return [] if image.side in sides and state.rng.random() < share else [image]
    return fault


def _twice(state: FaultState, image: SentImage) -> Sequence[SentImage]:
    return [image, image]


def _disordered(state: FaultState, image: SentImage) -> Sequence[SentImage]:
    """Send every two right images in the wrong order."""
    if image.side == 'left':
        return [image]
    before: Optional[SentImage] = state.kept.pop('right', None)
    if before is None:
        state.kept['right'] = image
        return []
    return [image, before]


def _later(seconds: float, sides: Sequence[str] = SIDES) -> Fault:
    """Return a fault that shifts stamps."""
    def fault(state: FaultState, image: SentImage) -> Sequence[SentImage]:
        return [replace(image, stamp_ns=image.stamp_ns + round(seconds * 1e9))
                if image.side in sides else image]
    return fault


def _jitter(state: FaultState, image: SentImage) -> Sequence[SentImage]:
    """Delay stamps by up to 10 ms, equally in both views."""
    rng = np.random.default_rng(image.exposure)
    return [replace(image, stamp_ns=image.stamp_ns + int(rng.integers(10_000_000)))]


def _stamp_of_zero(state: FaultState, image: SentImage) -> Sequence[SentImage]:
    return [replace(image, stamp_ns=0)] if image.side == 'left' and state.begins else [image]


def _stamps_of_zero(state: FaultState, image: SentImage) -> Sequence[SentImage]:
    return [replace(image, stamp_ns=0)]


FAULTS: dict[str, Fault] = {
    'none': _sound, 'unusable_image': _unusable, 'black': _black, 'garbage_right': _garbage,
    'frozen_pair': _frozen(SIDES), 'frozen_right': _frozen(('right',)), 'swapped': _swapped,
    'no_right': _lost(('right',)), 'no_images': _lost(SIDES),
    'lost_30_percent': _lost(SIDES, 0.3), 'twice': _twice, 'disordered': _disordered,
    'right_5_ms': _later(0.005, ('right',)), 'right_20_ms': _later(0.02, ('right',)),
    'right_50_ms': _later(0.05, ('right',)), 'clock_30_ms_on': _later(0.03),
    'clock_30_ms_back': _later(-0.03), 'clock_an_hour_on': _later(3600.0),
    'clock_an_hour_back': _later(-3600.0), 'stamp_jitter_10_ms': _jitter,
    'stamp_of_zero': _stamp_of_zero, 'stamps_of_zero': _stamps_of_zero}
ALWAYS = ('right_5_ms', 'right_20_ms', 'right_50_ms', 'stamp_jitter_10_ms')  # from the start on
APPROXIMATE = ('right_5_ms', 'right_20_ms', 'right_50_ms')  # with approximate pairing


class FaultyStream:
    """
    A stream of traffic with a fault that comes and goes; it can be iterated once.

    :param stream: the traffic.
    :param fault: one of ``FAULTS``.
    :param rng: source of all randomness of the fault.

    ``images`` has the images received since it was last cleared, in the order of arrival.
    """

    def __init__(self, stream: Iterable[TrafficPair], fault: str, rng: np.random.Generator
                 ) -> None:
        self._stream, self._name, self._rng = stream, fault, rng
        self._matcher = PairMatcher(LATE_TOLERANCE_NS if fault in APPROXIMATE else 0)
        self._last_ns = dict.fromkeys(SIDES, -1)
        self._anew = False
        self._index = 0
        self.images: list[SentImage] = []
        self.truth: list[tuple[Any, ...]] = []  # rows of each exposure

    def __iter__(self) -> Iterator[FaultyPair]:
        """Yield the pairs as they are received."""
        fault, state, held = FAULTS[self._name], FaultState(self._rng), False
        begins_s, ends_s, first_ns = self._next(0.0), 0.0, None
        ends_s = begins_s + self._length()
        for number, one in enumerate(self._stream):
            self.truth.append(one.truth)
            first_ns = one.pair.stamp_ns if first_ns is None else first_ns
            at_s = (one.pair.stamp_ns - first_ns) * 1e-9
            if at_s >= ends_s:
                begins_s = self._next(at_s)
                ends_s = begins_s + self._length()
            holds = self._name in ALWAYS or begins_s <= at_s < ends_s
            state.begins, held = holds and not held, holds
            for image in (SentImage('left', one.pair.stamp_ns, number, one.pair.left),
                          SentImage('right', one.pair.right_stamp_ns, number, one.pair.right)):
                for sent in fault(state, image) if holds else [image]:
                    yield from self._paired(sent)

    def _next(self, at_s: float) -> float:
        return at_s + float(self._rng.exponential(_PAUSE_S))

    def _length(self) -> float:
        return float(self._rng.uniform(0.1, _MOST_S))

    def _paired(self, image: SentImage) -> Iterator[FaultyPair]:
        """Take an image like ``nodes/pairing.py``; yield the pairs that are now certain."""
        self.images.append(image)
        last_ns = self._last_ns[image.side]
        if image.stamp_ns < last_ns - JUMP_NS:
            self._matcher.reset()
            self._last_ns = dict.fromkeys(SIDES, -1)
            self._anew = True
        elif image.stamp_ns <= last_ns:
            return
        self._last_ns[image.side] = image.stamp_ns
        add = self._matcher.add_left if image.side == 'left' else self._matcher.add_right
        for match in add(image.stamp_ns, image):
            yield self._faulty(match)

    def _faulty(self, match: Match) -> FaultyPair:
        left_ns, left, right_ns, right = match
        anew, self._anew = self._anew, False
        index, self._index = self._index, self._index + 1
        return FaultyPair(StereoPair(index, left_ns, right_ns, left.pixels, right.pixels),
                          left.exposure, anew)
