# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The detector in a process of its own, beside the tracks, with the same results as in turn.

Most of a search does not depend on what the tracks hold in the pair: where they do count, all
that matters is whether some places are too near to them.  So the other process searches each pair
with what the tracks are expected to hold, while they are updated, and tells what it asked of them
and how they answered.  Where the tracks as they are now answer alike, what it has found is what a
search after them would have found, to the last bit; where they do not, it searches again.

Each answer tells what the detector remembers, too.  So the search can go on in a process that is
ready by now, and goes on here where one dies or does not answer, as if it had always been there.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Callable, Mapping, Optional, Sequence, Union

from .config import DetectorConfig
from .detector import Memory, PlaneSweepDetector
from .protocol import Detection, TrackedRegion
from .spacing import Question
from ..core.helper_process import HelperProcess
from ..core.records import StereoPair
from ..core.shared_pair import SharedPair
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

_PIXEL_BYTES = 2  # of the greatest type of images
_PATIENCE = 3  # of the processor: readings come first, and the answer with the next pair


@dataclass(frozen=True, eq=False)
class Begin:
    """
    Begin to search for the vehicles of a rig and its lanes; it is not answered.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: parameters.
    :param memory: what is remembered of the pairs so far.
    :param pairs: those that it names, by stamp.
    """

    rig: StereoRig
    lanes: Mapping[str, LanePath]
    config: DetectorConfig
    memory: Memory = Memory()
    pairs: Mapping[int, StereoPair] = field(default_factory=dict)


@dataclass(frozen=True)
class Forget:
    """Forget the earlier pairs, as after a jump back of time; it is not answered."""


@dataclass(frozen=True, eq=False)
class Search:
    """
    Search a pair.

    :param pair: whose images lie in the shared memory.
    :param tracked: what the tracks are expected to hold.
    :param last_ns: stamp of the pair before, of which it may not have been told, and
    :param last_index: its number; None where there was none.
    """

    pair: SharedPair
    tracked: Sequence[TrackedRegion]
    last_ns: Optional[int] = None
    last_index: Optional[int] = None


@dataclass(frozen=True, eq=False)
class Again:
    """
    Search the same pair again.

    :param tracked: what the tracks hold.
    """

    tracked: Sequence[TrackedRegion]


@dataclass(frozen=True, eq=False)
class Found:
    """
    What came of a search.

    :param detections: without the pairs of their earlier fronts.
    :param since_ns: stamps of those pairs, for each.
    :param asked: of the tracks, with their answers.
    :param memory: what is remembered; its pairs may come up in later answers.
    """

    detections: Sequence[Detection]
    since_ns: Sequence[Sequence[int]]
    asked: Sequence[Question]
    memory: Memory


Request = Union[Begin, Forget, Search, Again]


def _none() -> None:
    """Return nothing."""


class SearchProcess(HelperProcess):
    """
    The process; it serves one detector after the other.

    :param answer_s: that a search may take; it takes some hundredths of a second.
    :param fork: as in :class:`HelperProcess`.
    """

    def __init__(self, answer_s: float = 5.0, *, fork: bool = False) -> None:
        super().__init__(
            'stereo_speed.detection.search_process', answer_s, _PATIENCE, fork=fork)
        self._unanswered = 0

    def ask(self, request: Union[Search, Again]) -> None:
        """
        Send what will be answered.

        :raises OSError: as of ``send``.
        """
        self.send(request)
        self._unanswered += 1

    def share(self, pair: StereoPair, most_bytes: int) -> SharedPair:
        """
        Lay the images of a pair into the shared memory; return what is told of it.

        :param most_bytes: that there may ever be in it.
        """
        shared = SharedPair.of(pair)
        shared.lay(pair, self.memory(most_bytes))
        return shared

    def answer(self) -> Found:
        """
        Return the answer to the last request that has one.

        :raises OSError: the process has ended, or does not answer in time.
        """
        found: Found = self.received()
        self._unanswered -= 1
        return found

    def serve_another(self) -> None:
        """
        Let go of the answers that the detector it served so far has not asked for.

        :raises OSError: as of ``answer``.
        """
        while self._unanswered:
            self.answer()


class DetectorBeside:
    """
    A :class:`PlaneSweepDetector` in another process; see the module's docstring.

    :param process: where it searches; None searches here until there is one.
    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: parameters.
    :param failed: takes the reason when the process is of no more use.
    :param coming: asked before each pair that is searched here for a process to move to.
    """

    def __init__(self, process: Optional[SearchProcess], rig: StereoRig,
                 lanes: Mapping[str, LanePath], config: DetectorConfig,
                 failed: Callable[[str], object],
                 coming: Callable[[], Optional[SearchProcess]] = _none) -> None:
        self._here = PlaneSweepDetector(rig, lanes, config)
        self._begin = Begin(rig, lanes, config)
        self._process: Optional[SearchProcess] = None
        self._memory = self._here.memory
        self._failed, self._coming = failed, coming
        self._pair: Optional[StereoPair] = None  # that is being searched
        self._passing: Optional[Memory] = None  # what is remembered after it, if it is not
        self._pairs: dict[int, StereoPair] = {}  # those that may come up in answers, by stamp
        self._most_bytes = 2 * _PIXEL_BYTES * max(
            camera.width_px * camera.height_px for camera in (rig.left, rig.right))
        if process is not None:
            self.move(process, failed)

    @property
    def is_here(self) -> bool:
        """Return whether it searches in this process, for want of another one."""
        return self._process is None

    def move(self, process: SearchProcess, failed: Callable[[str], object]) -> None:
        """
        Search in a process from now on, which remembers what was searched here.

        :param failed: takes the reason when it is of no more use.
        """
        self._memory, self._pairs = self._here.memory, self._here.pairs
        self._pair, self._passing = None, None
        self._process, self._failed = process, failed
        self._here.reset()  # it does not see the pairs that follow
        self._do(process.serve_another)
        self._send(replace(self._begin, memory=self._memory, pairs=self._pairs))

    def reset(self) -> None:
        """Forget the earlier pairs, as after a jump back of time."""
        self._here.reset()
        self._abandon()
        self._memory, self._pairs = self._memory.forgotten(), {}
        self._send(Forget())

    def expect(self, pair: StereoPair, tracked: Sequence[TrackedRegion]) -> None:
        """
        Begin with a pair.

        :param pair: in order of stamps.
        :param tracked: what the tracks are expected to hold in it.
        """
        self._abandon()
        if self._process is None and (ready := self._coming()) is not None:
            self.move(ready, self._failed)
        self._pair, process = pair, self._process
        if process is None:
            return
        self._passing = self._memory.passing(pair, self._begin.config)
        if self._passing is not None:
            return
        self._ask(Search(process.share(pair, self._most_bytes), tracked,
                         self._memory.last_ns, self._memory.last_index))

    def is_ready(self) -> bool:
        """Return whether the answer of the pair that is searched has come, or none is."""
        return self._pair is None or self._passing is not None or self._process is None \
            or self._process.has_answer()

    def update(self, pair: StereoPair, tracked: Sequence[TrackedRegion] = ()) -> list[Detection]:
        """
        Return the vehicles in a pair that no track holds.

        :param pair: that was expected, or the next one.
        :param tracked: what the tracks hold in it.
        """
        if self._pair is not pair:
            self.expect(pair, tracked)
        if self._pass():
            return []
        found = self._answer()
        if found is not None and not self._here.spacing.agree(
                found.asked, self._here.spacing.tracked(tracked)):
            self._ask(Again(tracked))
            found = self._answer()
        self._pair = None
        if found is None:
            return self._here.update(pair, tracked)
        out = [self._whole(*one)
               for one in zip(found.detections, found.since_ns, strict=True)]
        self._remember(pair, found)
        return out

    def _pass(self) -> bool:
        """Take in the pair where nothing is searched in it; return whether that is so."""
        if self._passing is None:
            return False
        self._memory, self._passing, self._pair = self._passing, None, None
        return True

    def _whole(self, detection: Detection, since_ns: Sequence[int]) -> Detection:
        """Return a detection with the pairs of these stamps, as they were measured here."""
        if detection.earlier is None:
            return detection
        pairs = tuple(self._pairs[ns] for ns in since_ns)
        return replace(detection, earlier=replace(detection.earlier, pairs=pairs))

    def _remember(self, pair: StereoPair, found: Found) -> None:
        """Keep the pairs that may come up in later answers."""
        pairs = {**self._pairs, pair.stamp_ns: pair}
        self._memory, self._pairs = found.memory, {ns: pairs[ns] for ns in found.memory.past_ns}

    def _abandon(self) -> None:
        """Let go of a pair whose search nobody asks for: a fault has come between."""
        if self._pass():
            return
        pair, self._pair = self._pair, None
        found = None if pair is None else self._answer()
        if pair is not None and found is not None:
            self._remember(pair, found)

    def _send(self, request: Union[Begin, Forget]) -> None:
        if self._process is not None:
            self._do(partial(self._process.send, request))

    def _ask(self, request: Union[Search, Again]) -> None:
        if self._process is not None:
            self._do(partial(self._process.ask, request))

    def _do(self, what: Callable[[], object]) -> None:
        try:
            what()
        except OSError as error:
            self._give_up(error)

    def _answer(self) -> Optional[Found]:
        """Return what the process has found; None where it is to be searched here."""
        if self._process is not None:
            try:
                return self._process.answer()
            except OSError as error:
                self._give_up(error)
        return None

    def _give_up(self, error: Exception) -> None:
        """Search here from now on, with what was remembered there."""
        self._process = None
        self._here.recall(self._memory, self._pairs)
        self._pairs = {}
        self._failed(str(error))
