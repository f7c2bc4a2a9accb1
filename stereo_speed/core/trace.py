# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How a pass came about: how its tracker was started, what it was fed, and what it returned.

A trace suffices to measure the pass again, together with the images of its pairs, the rig, the
lanes and the parameters.
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
    One pair that a tracker was fed, and the resulting update.

    :param stamp_ns: header stamp of the left image, ns.
    :param right_stamp_ns: stamp of the right image as the tracker got it, ns.
    :param particles: number of particles set before this pair; None if it was not set.
    :param motion: rotation of the rig; None if it stood as when the site was learnt.
    :param update: the tracker's update; None if it returned none.
    :param others: fronts of other vehicles in the pair.
    :param stamp_error_s: difference of the header stamps, s, if it was found to be an error.
    :param right_came_ns: original header stamp of the right image, ns; None if it equals
        ``right_stamp_ns``.
    :param hurried: whether the tracker was told to do less with this pair because other tracks
        had their turn.
    :param stamp_std_s: 1-sigma of the stamps assumed for this pair, s, if they were less even
        than the parameter ``stamp_std_s`` says; None otherwise.
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
        """Return the original header stamp of the right image, ns."""
        return self.right_stamp_ns if self.right_came_ns is None else self.right_came_ns


@dataclass(frozen=True, eq=False)
class PassTrace:
    """
    How one pass came about.

    :param track: number of the track, which together with the seed identifies its random stream.
    :param seed: seed of all randomness.
    :param lane: name of the lane on whose path the tracker was started.
    :param front: front that the tracker was started from.
    :param particles: number of particles that the tracker was started with.
    :param seen_mps: speed measured by the detector, m/s; None if it measured none.
    :param pairs: pairs that the tracker was fed, in order of stamps.
    :param stamp_std_s: 1-sigma of the stamps assumed at the start, s, if they were less even than
        the parameter ``stamp_std_s`` says; None otherwise.
    :param rest_std_rad: 1-sigmas of the lane's direction, across and up, by how the rig sways,
        rad; None where it does not, or the lines of the site tell its rest.
    """

    track: int
    seed: int
    lane: str
    front: InitialFront
    particles: int
    seen_mps: Optional[float]
    pairs: tuple[TracePair, ...]
    stamp_std_s: Optional[float] = None
    rest_std_rad: Optional[tuple[float, float]] = None

    def shown(self, measured_ns: Container[int]) -> tuple[TracePair, ...]:
        """
        Return the measured pairs in which the track was confirmed.

        Before that, the tracked front may lie metres from the vehicle's front.

        :param measured_ns: stamps of the pairs that the speed was measured from.
        """
        return tuple(p for p in self.pairs if p.update is not None
                     and p.update.state is TrackState.CONFIRMED and p.stamp_ns in measured_ns)


class TraceBuilder:
    """
    Builds the trace of a track while it is followed.

    :param trace: trace without pairs.
    """

    def __init__(self, trace: PassTrace) -> None:
        self._trace = trace
        self._pairs: list[TracePair] = []

    @property
    def first_ns(self) -> Optional[int]:
        """Return the stamp of the first pair, ns; None before it."""
        return self._pairs[0].stamp_ns if self._pairs else None

    @property
    def start(self) -> PassTrace:
        """Return the trace without pairs, which tells how the track was started."""
        return self._trace

    def copy_others(self, source: TraceBuilder) -> None:
        """Copy the fronts of other vehicles from another trace of the same pairs."""
        others = {p.stamp_ns: p.others for p in source._pairs}
        self._pairs = [replace(p, others=others.get(p.stamp_ns, ())) for p in self._pairs]

    def add(self, pair: StereoPair, particles: Optional[int],
            update: Optional[TrackUpdate], *, hurried: bool = False,
            stamp_std_s: Optional[float] = None) -> None:
        """
        Add a pair that the tracker was fed.

        :param pair: the pair as it was fed.
        :param particles: number of particles set before this pair; None if it was not set.
        :param update: the tracker's update; None if it returned none.
        :param hurried: whether the tracker was told to do less with this pair.
        :param stamp_std_s: 1-sigma of the stamps, s, if they were less even than expected.
        """
        self._pairs.append(TracePair(
            pair.stamp_ns, pair.right_stamp_ns, particles, pair.motion, update,
            stamp_error_s=pair.stamp_error_s, right_came_ns=pair.right_came_ns,
            hurried=hurried, stamp_std_s=stamp_std_s))

    def add_others(self, stamp_ns: int, updates: Sequence[TrackUpdate]) -> None:
        """
        Add the fronts of other vehicles to a pair.

        Each other track has one front in a pair: its solution for the pair replaces its
        prediction.

        :param stamp_ns: stamp of the pair, ns; nothing is done if the tracker was not fed it.
        :param updates: updates of vehicles in the pair; those of this track are ignored.
        """
        for k in range(len(self._pairs) - 1, -1, -1):
            if self._pairs[k].stamp_ns <= stamp_ns:
                if self._pairs[k].stamp_ns == stamp_ns:
                    others = (*self._pairs[k].others, *self._others(updates))
                    self._pairs[k] = replace(
                        self._pairs[k], others=tuple({o.track: o for o in others}.values()))
                return

    def _others(self, updates: Sequence[TrackUpdate]) -> tuple[OtherFront, ...]:
        """Return the fronts of other vehicles whose corners are finite in both views."""
        return tuple(OtherFront(u.track, u.quad_left_px, u.quad_right_px) for u in updates
                     if u.track != self._trace.track and np.isfinite(u.quad_left_px).all()
                     and np.isfinite(u.quad_right_px).all())

    def built(self, stamp_std_s: Optional[float] = None) -> PassTrace:
        """
        Return the trace so far.

        :param stamp_std_s: final 1-sigma of the stamps, s, if they were less even than expected;
            it may become known only after the last pair was fed.
        """
        pairs = self._pairs
        if pairs and stamp_std_s is not None:
            pairs = [*pairs[:-1], replace(pairs[-1], stamp_std_s=stamp_std_s)]
        return replace(self._trace, pairs=tuple(pairs))
