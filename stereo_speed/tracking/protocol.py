# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What every tracker is: one front to start from, pairs in, updates out, one result at the end.

Trackers are found by name: those of this package in ``pipeline.registry``, those of other packages
through the entry-point group ``stereo_speed.trackers``.  ``CONTRIBUTING.md`` shows how to add one.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional, Protocol, runtime_checkable, Union

import numpy as np

from ..core.config import TrackerConfig
from ..core.errors import InputError
from ..core.passes import PassResult
from ..core.records import InitialFront, StereoPair, TrackUpdate
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

# What pipeline and trackers go by where not every vehicle is solved for in every pair.
OLD_S = 0.3  # of a solution: a vehicle that brakes is 0.3 m off by then, and 2 m/s slower
OCCLUDED_TIMES = 3.0  # as old when pairs wait and it is occluded: most looks are in vain
MOST_TIMES = 2.0  # as long, after which no vehicle gives way to another


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackStart:
    """
    All that a tracker starts from.

    :param rig: the cameras.
    :param lane: the lane whose path the front is nearest to.
    :param config: parameters that all trackers share.
    :param front: the front in the first pair.
    :param pair: the first pair; it is fed to the tracker as well.
    :param track: number of the track, never reused.
    :param rng: source of all randomness of the track.
    :param seen_mps: speed as the detector saw it; None where it saw none.
    :param particles_alone: number of particles that it has when it is the only track; None for
        those of ``config``, which are its share among others.
    :param told_stamp_std_s: 1-sigma of stamps that are those of the exposures, s; None for that of
        ``config``, which is greater where they are uneven.
    """

    rig: StereoRig
    lane: LanePath
    config: TrackerConfig
    front: InitialFront
    pair: StereoPair
    track: int
    rng: np.random.Generator
    seen_mps: Optional[float] = None
    particles_alone: Optional[int] = None
    told_stamp_std_s: Optional[float] = None

    @property
    def expected_mps(self) -> float:
        """Return the expected speed: the limit of the lane, or that of lanes without one."""
        return self.lane.speed_limit_mps or self.config.initial_speed_mps

    @property
    def expected_std_mps(self) -> float:
        """
        Return the 1-sigma of a Gaussian about the expected speed.

        It is twice that of most particles, which leave the unforeseen speeds to a few others.
        """
        return 2 * self.config.initial_speed_std * self.expected_mps


@dataclass(frozen=True)
class Refusal:
    """
    Why no track starts: the images do not show one front in both views.

    :param where: pair at fault.
    :param what: what is wrong there.
    :param found: what was there.
    :param wanted: what should have been there.
    """

    where: str
    what: str
    found: str
    wanted: str

    def error(self) -> InputError:
        """Return the error to raise where a person annotated the front."""
        return InputError(self.where, self.what, self.found, self.wanted)


class Tracker(Protocol):
    """
    One vehicle followed through the pairs of its pass.

    Live, its result is asked for in another process, for which it is pickled when the pass is
    over; one that cannot be pickled is asked in the node, where other vehicles may wait for it.
    """

    @property
    def track(self) -> int:
        """Return the number of the track."""

    @property
    def ended(self) -> bool:
        """Return whether the pass is over: out of view, or lost for too long."""

    def update(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """
        Take in one pair, in order of stamps.

        :return: None once the pass has ended.
        """

    def result(self) -> PassResult:
        """Return the measurement of the pass from all pairs so far."""


class TrackerType(Protocol):
    """
    A class of trackers, as the registry finds it.

    ``Settings`` is the config record of its own parameters (:class:`..core.config.NoParameters`
    where it has none): a frozen dataclass of ``parameter`` fields.
    """

    Settings: type[Any]

    def start(self, start: TrackStart, settings: Any) -> Union[Tracker, Refusal]:
        """
        Return a tracker that follows a front, or the reason why it cannot.

        :param start: what it starts from.
        :param settings: a record of its ``Settings``.
        """


@runtime_checkable
class SharesParticles(Protocol):
    """A tracker whose number of particles can change under way."""

    def share(self, particles: int) -> None:
        """Go on with another number of particles, when tracks come and go."""


@runtime_checkable
class DoubtsStamps(Protocol):
    """A tracker that takes in, under way, that its stamps are worse than it was told."""

    def doubt_stamps(self, stamp_std_s: float) -> None:
        """
        Take all stamps of the pass to have another 1-sigma.

        :param stamp_std_s: in place of that of its parameters, s.
        """


@runtime_checkable
class CanHurry(Protocol):
    """A tracker that can do less with a pair, at the cost of a greater 1-sigma."""

    def hurry(self, hurried: bool) -> None:
        """Be told whether the next pairs are to cost little, for others have their turn."""


@runtime_checkable
class CarriesOn(Protocol):
    """A tracker that can tell of a pair before it has solved for it."""

    def carry(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """
        Take in a pair as ``update`` does if that takes no solution.

        :return: None where it does; then nothing has changed.
        """

    def expected(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """
        Return where the vehicle is in a pair by what is known before it, while this is worked on.

        It may be asked while another thread has the tracker take in other pairs.

        :return: None where the speed is not known, or the pair does not show the vehicle there.
        """


@runtime_checkable
class TellsAge(Protocol):
    """
    A tracker that knows how old its last solution is.

    Of one that does not, the last is taken to be that of the last pair that it was not hurried in.
    """

    def unsolved_s(self, stamp_ns: int) -> float:
        """
        Return how old its last solution is, s; infinite where it can do no less than solve.

        Who has less need of one, as what is occluded and was looked for in vain, tells less.

        :param stamp_ns: of the next pair.
        """
