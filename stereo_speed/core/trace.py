# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How a pass came about: what its tracker was started with and fed, and what it said of each pair.

With the images of its pairs, the rig, the lanes and the parameters, a trace is all it takes to
measure the pass again.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Container, Optional, Sequence

import numpy as np

from .records import Array, InitialFront, RigMotion, StereoPair, TrackState, TrackUpdate


@dataclass(frozen=True, eq=False)
class OtherFront:
    """
    The front of another vehicle in a pair of the pass.

    :param track: number of its track.
    :param left_px: (4, 2) corners in the raw left image, px.
    :param right_px: (4, 2) the same in the raw right image, px.
    """

    track: int
    left_px: Array
    right_px: Array


@dataclass(frozen=True, eq=False)
class TracePair:
    """
    One pair that a tracker was fed, and what came of it.

    :param stamp_ns: header stamp of the left image, ns.
    :param right_stamp_ns: stamp of the right image as it was fed, ns.
    :param particles: number of particles that the tracker was told to go on with; None where it
        was told none.
    :param motion: how the rig stood; None where it stood as when the site was learnt.
    :param update: what the tracker said; None where it said nothing.
    :param others: fronts of other vehicles in the pair.
    :param stamp_error_s: difference of the stamps, s, that was found to be an error.
    :param right_came_ns: header stamp of the right image as it came; None for that fed.
    :param hurried: whether the tracker was told to do little with it, for others had their turn.
    :param stamp_std_s: 1-sigma, s, that the stamps were taken to have by then, where they were
        less even than the parameter has it.
    """

    stamp_ns: int
    right_stamp_ns: int
    particles: Optional[int]
    motion: Optional[RigMotion]
    update: Optional[TrackUpdate]
    others: tuple[OtherFront, ...] = ()
    stamp_error_s: float = 0.0
    right_came_ns: Optional[int] = None
    hurried: bool = False
    stamp_std_s: Optional[float] = None

    @property
    def right_image_ns(self) -> int:
        """Return the header stamp that the right image came with, ns."""
        return self.right_stamp_ns if self.right_came_ns is None else self.right_came_ns


@dataclass(frozen=True, eq=False)
class PassTrace:
    """
    How one pass came about.

    :param track: number of the track; with the seed it names its random stream.
    :param seed: of all randomness.
    :param lane: name of the lane whose path it was started on.
    :param front: the front it was started from.
    :param particles: number of particles it was started with.
    :param seen_mps: speed as the detector saw it; None where it saw none.
    :param pairs: those it was fed, in order of stamps.
    :param stamp_std_s: 1-sigma that the stamps were taken to have when it began, where they were
        less even than the parameter has it; else None.
    """

    track: int
    seed: int
    lane: str
    front: InitialFront
    particles: int
    seen_mps: Optional[float]
    pairs: tuple[TracePair, ...]
    stamp_std_s: Optional[float] = None

    def shown(self, measured_ns: Container[int]) -> tuple[TracePair, ...]:
        """
        Return the pairs that show the vehicle where it was measured.

        The front of a track that is not confirmed yet may lie metres from the vehicle's.

        :param measured_ns: stamps of the pairs that its speed is measured from.
        """
        return tuple(p for p in self.pairs if p.update is not None
                     and p.update.state is TrackState.CONFIRMED and p.stamp_ns in measured_ns)


class TraceBuilder:
    """
    Gathers the trace of a track while it is followed.

    :param trace: with no pairs yet.
    """

    def __init__(self, trace: PassTrace) -> None:
        self._trace = trace
        self._pairs: list[TracePair] = []

    @property
    def begun(self) -> PassTrace:
        """Return how the track began."""
        return self._trace

    def see_others_of(self, other: TraceBuilder) -> None:
        """Take over what another trace of the same pairs has of other vehicles."""
        others = {p.stamp_ns: p.others for p in other._pairs}
        self._pairs = [replace(p, others=others.get(p.stamp_ns, ())) for p in self._pairs]

    def add(self, pair: StereoPair, particles: Optional[int],
            update: Optional[TrackUpdate], *, hurried: bool = False,
            stamp_std_s: Optional[float] = None) -> None:
        """
        Add a pair that the tracker was fed.

        :param pair: as it was fed.
        :param particles: number of particles it was told before; None where it was told none.
        :param update: what the tracker said.
        :param hurried: whether it was told to do little.
        :param stamp_std_s: 1-sigma of the stamps, where they were less even than they should be.
        """
        self._pairs.append(TracePair(
            pair.stamp_ns, pair.right_stamp_ns, particles, pair.motion, update,
            stamp_error_s=pair.stamp_error_s, right_came_ns=pair.right_came_ns,
            hurried=hurried, stamp_std_s=stamp_std_s))

    def add_others(self, stamp_ns: int, updates: Sequence[TrackUpdate]) -> None:
        """
        Add fronts of other vehicles in a pair to those that are there.

        Of one track there is one: what it says after it has solved for the pair takes the place
        of what was expected of it.

        :param stamp_ns: of that pair; who was not fed it is left as it is.
        :param updates: of vehicles in it.
        """
        for k in range(len(self._pairs) - 1, -1, -1):
            if self._pairs[k].stamp_ns <= stamp_ns:
                if self._pairs[k].stamp_ns == stamp_ns:
                    others = (*self._pairs[k].others, *self._others(updates))
                    self._pairs[k] = replace(
                        self._pairs[k], others=tuple({o.track: o for o in others}.values()))
                return

    def _others(self, updates: Sequence[TrackUpdate]) -> tuple[OtherFront, ...]:
        """Return the fronts of other vehicles that lie somewhere."""
        return tuple(OtherFront(u.track, u.quad_left_px, u.quad_right_px) for u in updates
                     if u.track != self._trace.track and np.isfinite(u.quad_left_px).all()
                     and np.isfinite(u.quad_right_px).all())

    def built(self, stamp_std_s: Optional[float] = None) -> PassTrace:
        """
        Return the trace so far.

        :param stamp_std_s: 1-sigma that its stamps were taken to have in the end, where they were
            less even than they should be: it may have been known after the last pair was fed.
        """
        pairs = self._pairs
        if pairs and stamp_std_s is not None:
            pairs = [*pairs[:-1], replace(pairs[-1], stamp_std_s=stamp_std_s)]
        return replace(self._trace, pairs=tuple(pairs))
