# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The detector in a process of its own, beside the tracks, with the same results as one in turn.

Most of a search does not depend on the tracks; where it does, it only asks whether a place is too
near to a region that a track holds.  So the other process searches each pair with the regions that
the tracks are expected to hold, while the tracks are updated.  It returns its questions with their
answers.  If the updated tracks give the same answers, the result equals that of a search after the
update, bit for bit; if they do not, the process searches again.

Each result also contains the state of the detector.  So the search can move to a process that has
become ready, and continues in this process if the other one ends or does not answer, with the same
results.
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

_PIXEL_BYTES = 2  # size of a pixel of the largest image type
_PATIENCE = 3  # niceness: readings come first, and the answer is due with the next pair


@dataclass(frozen=True, eq=False)
class Begin:
    """
    Request to begin with a detector; it has no answer.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: parameters.
    :param memory: initial state of the detector.
    :param pairs: stamp to pair, for the pairs that the state refers to.
    """

    rig: StereoRig
    lanes: Mapping[str, LanePath]
    config: DetectorConfig
    memory: Memory = Memory()
    pairs: Mapping[int, StereoPair] = field(default_factory=dict)


@dataclass(frozen=True)
class Forget:
    """Request to discard all earlier pairs, as after a jump back in time; it has no answer."""


@dataclass(frozen=True, eq=False)
class Search:
    """
    Request to search a pair.

    :param pair: the pair, with its images in the shared memory.
    :param tracked: regions that tracks are expected to hold.
    :param last_ns: stamp of the previous pair, which may not have been sent, ns; None if there is
        none.
    :param last_index: number of the previous pair; None if there is none.
    """

    pair: SharedPair
    tracked: Sequence[TrackedRegion]
    last_ns: Optional[int] = None
    last_index: Optional[int] = None


@dataclass(frozen=True, eq=False)
class Again:
    """
    Request to search the same pair again.

    :param tracked: regions that tracks hold.
    """

    tracked: Sequence[TrackedRegion]


@dataclass(frozen=True, eq=False)
class Found:
    """
    The answer to a search.

    :param detections: detections without the pairs of their earlier fronts.
    :param since_ns: stamps of these pairs, for each detection.
    :param asked: questions about the tracks, with their answers.
    :param memory: state of the detector; later answers may refer to its pairs.
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
    The search process; it serves one detector after the other.

    :param answer_s: time-out of a search, s; one takes some hundredths of a second.
    :param fork: as in :class:`HelperProcess`.
    """

    def __init__(self, answer_s: float = 5.0, *, fork: bool = False) -> None:
        super().__init__(
            'stereo_speed.detection.search_process', answer_s, _PATIENCE, fork=fork)
        self._unanswered = 0

    def ask(self, request: Union[Search, Again]) -> None:
        """
        Send a request that has an answer.

        :raises OSError: as of ``send``.
        """
        self.send(request)
        self._unanswered += 1

    def share(self, pair: StereoPair, most_bytes: int) -> SharedPair:
        """
        Copy the images of a pair into the shared memory; return the pair to send.

        :param pair: the pair.
        :param most_bytes: greatest size that the memory will ever need.
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
        Discard the answers that the previous detector has not collected.

        :raises OSError: as of ``answer``.
        """
        while self._unanswered:
            self.answer()


class DetectorBeside:
    """
    A :class:`PlaneSweepDetector` in another process; see the module's docstring.

    :param process: the process to search in; None to search here until there is one.
    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: parameters.
    :param failed: called with the reason when the process is no longer usable.
    :param coming: called before each pair that is searched here; returns a process to move to, or
        None.
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
        self._pair: Optional[StereoPair] = None  # the pair that is being searched
        self._passing: Optional[Memory] = None  # state after that pair, if it is not searched
        self._pairs: dict[int, StereoPair] = {}  # pairs that answers may refer to, by stamp
        self._most_bytes = 2 * _PIXEL_BYTES * max(
            camera.width_px * camera.height_px for camera in (rig.left, rig.right))
        if process is not None:
            self.move(process, failed)

    @property
    def is_here(self) -> bool:
        """Return whether it searches in this process, because there is no other one."""
        return self._process is None

    def move(self, process: SearchProcess, failed: Callable[[str], object]) -> None:
        """
        Search in another process from now on, which takes over the state of the search here.

        :param process: that process.
        :param failed: called with the reason when the process is no longer usable.
        """
        self._memory, self._pairs = self._here.memory, self._here.pairs
        self._pair, self._passing = None, None
        self._process, self._failed = process, failed
        self._here.reset()  # it does not see the pairs that follow
        self._do(process.serve_another)
        self._send(replace(self._begin, memory=self._memory, pairs=self._pairs))

    def reset(self) -> None:
        """Discard all earlier pairs, as after a jump back in time."""
        self._here.reset()
        self._abandon()
        self._memory, self._pairs = self._memory.forgotten(), {}
        self._send(Forget())

    def expect(self, pair: StereoPair, tracked: Sequence[TrackedRegion]) -> None:
        """
        Begin to search a pair.

        :param pair: pairs in order of stamps.
        :param tracked: regions that tracks are expected to hold in it.
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
        """Return whether no pair is being searched, or its answer has arrived."""
        return self._pair is None or self._passing is not None or self._process is None \
            or self._process.has_answer()

    def update(self, pair: StereoPair, tracked: Sequence[TrackedRegion] = ()) -> list[Detection]:
        """
        Return the vehicles in a pair that no track holds.

        :param pair: the pair that ``expect`` was called with, or the next one.
        :param tracked: regions that tracks hold in it.
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
        """Register the pair if it is not to be searched; return whether that is so."""
        if self._passing is None:
            return False
        self._memory, self._passing, self._pair = self._passing, None, None
        return True

    def _whole(self, detection: Detection, since_ns: Sequence[int]) -> Detection:
        """Return a detection with the pairs of these stamps, as kept in this process."""
        if detection.earlier is None:
            return detection
        pairs = tuple(self._pairs[ns] for ns in since_ns)
        return replace(detection, earlier=replace(detection.earlier, pairs=pairs))

    def _remember(self, pair: StereoPair, found: Found) -> None:
        """Keep the state, and the pairs that later answers may refer to."""
        pairs = {**self._pairs, pair.stamp_ns: pair}
        self._memory, self._pairs = found.memory, {ns: pairs[ns] for ns in found.memory.past_ns}

    def _abandon(self) -> None:
        """Drop a pair whose result was never collected because of a fault."""
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
        """Return the answer of the process; None where the pair is to be searched here."""
        if self._process is not None:
            try:
                return self._process.answer()
            except OSError as error:
                self._give_up(error)
        return None

    def _give_up(self, error: Exception) -> None:
        """Search here from now on, from the last known state."""
        self._process = None
        self._here.recall(self._memory, self._pairs)
        self._pairs = {}
        self._failed(str(error))
