# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The keyframes of a pass, and what is known of the vehicle at them.

A live reading is solved from a window of active keyframes; older ones become inactive, and keep
their pairs until the pass is solved as a whole.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Sequence

import numpy as np
from numpy.typing import NDArray

from .motion_prior import StateIndex
from .observation import Observation
from ..core.records import Array, StereoPair


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A pair and the observation of the front in it."""

    pair: StereoPair
    observation: Observation


@dataclass(frozen=True, eq=False)
class Window:
    """
    What is known of a pass so far.

    :param keyframes: active keyframes, in order of stamps.
    :param states: (n, 4) s, a, b in m and speed in m/s, in each of them.
    :param relief: (m,) relief of the front at its nodes, m.
    :param relief_weights: (m,) factors on the usual information that holds nodes to the plane.
    :param inactive: pairs that wait for the end of the pass, in order of stamps.
    :param occluded_ns: stamps of the pairs, active or not, that do not count.
    :param changing_lanes: probability that the vehicle changes lanes.
    :param more_px: scatter of the disparities beyond the least one, px.
    """

    keyframes: tuple[Keyframe, ...]
    states: Array
    relief: Array
    relief_weights: Array
    inactive: tuple[StereoPair, ...] = ()
    occluded_ns: frozenset[int] = frozenset()
    changing_lanes: float = 0.0
    more_px: float = 0.0

    @property
    def pairs(self) -> list[StereoPair]:
        """Return the active pairs."""
        return [keyframe.pair for keyframe in self.keyframes]

    @property
    def observations(self) -> list[Observation]:
        """Return the active observations."""
        return [keyframe.observation for keyframe in self.keyframes]

    @property
    def times_s(self) -> Array:
        """Return the times (n,) since the first pair, s."""
        first = self.keyframes[0].pair.stamp_ns
        return np.array([(k.pair.stamp_ns - first) * 1e-9 for k in self.keyframes])

    @property
    def index(self) -> StateIndex:
        """Return the indices of the unknowns except the relief."""
        return StateIndex(len(self.keyframes))

    def counts(self) -> NDArray[np.bool_]:
        """Return which observations (n,) count."""
        return np.array([pair.stamp_ns not in self.occluded_ns for pair in self.pairs])

    def inserted(self, k: int, keyframe: Keyframe, state: Array) -> Window:
        """Return the window with a keyframe and its state (4,) before number ``k``."""
        return replace(
            self, keyframes=(*self.keyframes[:k], keyframe, *self.keyframes[k:]),
            states=np.insert(self.states, k, state, axis=0))

    def deactivated(self, k: int, most: int) -> Window:
        """Return the window with keyframe ``k`` inactive, and at most ``most`` inactive ones."""
        inactive = sorted((*self.inactive, self.keyframes[k].pair), key=lambda p: p.stamp_ns)
        if len(inactive) > most:
            del inactive[least_gap(inactive)]
        return replace(
            self, keyframes=self.keyframes[:k] + self.keyframes[k + 1:],
            states=np.delete(self.states, k, axis=0), inactive=tuple(inactive))

    def since(self, k: int) -> Window:
        """Return the window, which has no inactive pairs, from keyframe ``k`` on."""
        return replace(self, keyframes=self.keyframes[k:], states=self.states[k:])

    def unshown(self, fewest: int) -> int:
        """Return how many leading keyframes do not count; 0 if fewer than ``fewest`` follow."""
        first = int(np.argmax(self.counts()))
        return first if first <= len(self.keyframes) - fewest else 0

    def judged(self, unoccluded: NDArray[np.bool_]) -> Window:
        """Return the window with a new choice of what counts, unless that left nothing."""
        if not unoccluded.any():
            return self
        elsewhere = self.occluded_ns.difference(pair.stamp_ns for pair in self.pairs)
        return replace(self, occluded_ns=elsewhere.union(
            pair.stamp_ns for pair, counts in zip(self.pairs, unoccluded) if not counts))


def least_gap(pairs: Sequence[StereoPair]) -> int:
    """Return the index of the pair, not the first or last, whose removal leaves the least gap."""
    times = np.array([pair.stamp_ns for pair in pairs])
    return 1 + int(np.argmin(times[2:] - times[:-2])) if len(times) > 2 else len(times) - 1
