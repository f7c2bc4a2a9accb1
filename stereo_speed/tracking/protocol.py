# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The interface of trackers: one front to start from, pairs in, updates out, one result at the end.

Trackers are found by name: those of this package in ``pipeline.registry``, those of other packages
through the entry-point group ``stereo_speed.trackers``.  ``CONTRIBUTING.md`` shows how to add one.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional, Protocol, runtime_checkable, Sequence, Union

import numpy as np

from ..core.errors import InputError
from ..core.passes import PassResult, TrackEnd
from ..core.records import InitialFront, StereoPair, TrackUpdate
from ..core.stamp_watch import Gap
from ..core.tracker_config import TrackerConfig
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

# Limits for pipeline and trackers where not every vehicle is solved for in every pair.
OLD_S = 0.3  # age from which a solution is old; a braking vehicle is 0.3 m off and 2 m/s slower
OCCLUDED_TIMES = 3.0  # factor on it in hurried pairs while occluded, as most looks fail then
MOST_TIMES = 2.0  # multiple of the usual interval after which no vehicle gives way to another


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackStart:
    """
    The data that a tracker starts from.

    :param rig: the cameras.
    :param lane: the lane whose path the front is nearest to.
    :param config: parameters that all trackers share.
    :param front: the front in the first pair.
    :param pair: the first pair; it is fed to the tracker as well.
    :param track: number of the track, never reused.
    :param rng: source of all randomness of the track.
    :param seen_mps: speed by the detector, m/s; None where it gave none.
    :param particles_alone: number of particles of a track that is alone; None for that of
        ``config``, which is the share of the track among others.
    :param nominal_stamp_std_s: 1-sigma of correct stamps, s; that of ``config`` is larger while
        stamps are uneven. None for that of ``config``.
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
    nominal_stamp_std_s: Optional[float] = None

    @property
    def expected_mps(self) -> float:
        """Return the expected speed: the limit of the lane, or that of lanes without one."""
        return self.lane.speed_limit_mps or self.config.initial_speed_mps

    @property
    def expected_std_mps(self) -> float:
        """
        Return the 1-sigma of a Gaussian about the expected speed.

        It is twice that of most particles, as a few other particles cover unexpected speeds.
        """
        return 2 * self.config.initial_speed_std * self.expected_mps


@dataclass(frozen=True)
class Refusal:
    """
    The reason why no track starts: the images do not show one front in both views.

    :param where: the pair.
    :param what: what is wrong there.
    :param found: what was found.
    :param wanted: what was expected.
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
    Follows one vehicle through the pairs of its pass.

    Live, the tracker is pickled when the pass is over, and its result is computed in another
    process.  If it cannot be pickled, the node computes the result, and other vehicles may have to
    wait.
    """

    @property
    def track(self) -> int:
        """Return the number of the track."""

    @property
    def ended(self) -> bool:
        """Return whether the pass is over: out of view, or lost for too long."""

    def update(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """
        Process one pair; pairs come in order of stamps.

        :return: the update; None once the pass has ended.
        """

    def result(self) -> PassResult:
        """Return the measurement of the pass from all pairs so far."""


class TrackerType(Protocol):
    """
    A class of trackers, as the registry loads it.

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
    """A tracker whose number of particles can change during a pass."""

    def share(self, particles: int) -> None:
        """Change the number of particles, when tracks come and go."""


@runtime_checkable
class DoubtsStamps(Protocol):
    """A tracker that can be told during a pass that its stamps are worse than assumed."""

    def doubt_stamps(self, stamp_std_s: float) -> None:
        """
        Assume another 1-sigma of all stamps of the pass.

        :param stamp_std_s: replaces that of its parameters, s.
        """


@runtime_checkable
class SeesGaps(Protocol):
    """A tracker that can tell missing images from a clock that was set forward."""

    def see_gaps(self, gaps: Sequence[Gap]) -> None:
        """
        Take in the latest gaps of the stream, before a pair and before the result is asked for.

        :param gaps: all that may lie in the pass, in order; others are to be ignored.
        """

    @property
    def clock_step(self) -> Optional[Gap]:
        """Return a gap in which the clock was certainly set forward; None if there is none."""


@runtime_checkable
class CanHurry(Protocol):
    """A tracker that can do less with a pair, at the cost of a larger 1-sigma."""

    def hurry(self, hurried: bool) -> None:
        """Set whether to do little with the next pairs, because others have their turn."""


@runtime_checkable
class CarriesOn(Protocol):
    """A tracker that can predict its update for a pair before it has solved for it."""

    def carry(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """
        Process a pair as ``update`` does, provided that it needs no solution.

        :return: the update; None where a solution is needed, and then nothing has changed.
        """

    def expected(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """
        Return the update predicted for a pair from earlier ones, while the pair is solved for.

        It may be called while the tracker processes other pairs in another thread.

        :return: None where the speed is not known, or the pair does not show the vehicle there.
        """


@runtime_checkable
class TellsAge(Protocol):
    """
    A tracker that knows the age of its last solution.

    For other trackers, the last pair in which they were not hurried is taken for their last
    solution.
    """

    def unsolved_s(self, stamp_ns: int) -> float:
        """
        Return the age of its last solution, s; infinite where it must solve now.

        A tracker that needs a solution less, such as one that often looked in vain for an occluded
        vehicle, may return less.

        :param stamp_ns: stamp of the next pair.
        """


@runtime_checkable
class TellsEnd(Protocol):
    """
    A tracker that knows how its pass ended before the pass is measured.

    For other trackers, a vehicle has left the view if its last pair showed it.
    """

    @property
    def end(self) -> Optional[TrackEnd]:
        """Return how the pass ended; None while it goes on."""
