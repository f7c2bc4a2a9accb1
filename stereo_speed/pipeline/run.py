# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The one loop from a stream of pairs to the results of a run."""
from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
import time
from typing import Callable, Collection, Iterable, Optional, Protocol, Sequence

from .conclusions import Later
from .pipeline import SpeedPipeline, Step
from ..core.passes import PassResult
from ..core.records import StereoPair, TrackUpdate

Observer = Callable[[StereoPair, Step], None]
# Number of pairs, held with their images, whose report may wait for passes to be measured; a pass
# takes as long as some forty pairs, and longer beside other programs.
MOST_UNTOLD = 80
MOST_UNTOLD_BYTES = 128 << 20  # limit for their images: 80 pairs of 1024 x 768, fewer if larger
# Number of updates that a run with a sink holds, for pictures; 60 MB.
KEPT_UPDATES = 40_000


class Sink(Protocol):
    """Takes the updates of a run as they come, so that not all have to be held in memory."""

    def add(self, updates: Sequence[TrackUpdate], passes: Sequence[PassResult],
            open_tracks: Collection[int]) -> None:
        """
        Take in the results of one pair.

        :param updates: updates of the pair.
        :param passes: passes that have been measured since the last pair.
        :param open_tracks: numbers of the tracks whose passes are still to come.
        """


class Relay(Protocol):
    """Lets one pipeline continue from another, and keeps the results of pairs."""

    def ends(self, pair: StereoPair, pipeline: SpeedPipeline) -> bool:
        """Return whether another pipeline is to continue after a pair."""

    def begin(self, pipeline: SpeedPipeline, so_far: Run) -> SpeedPipeline:
        """Return the pipeline that continues from one; all pairs so far have been reported."""

    def tell(self, pair: StereoPair, step: Step, open_tracks: Collection[int]) -> None:
        """Take in the results of a pair, in order; see :class:`Sink`."""


@dataclass
class Run:
    """
    The results of a run.

    :param updates: updates of tracks that have a pass, in time order.
    :param passes: results of the passes, by track.
    :param stamps_ns: stamp of each pair.
    :param wall_s: time spent in the pipeline, s.
    :param cpu_s: processor time spent on pairs, s, without that for passes still open at the end.
    :param kept: numbers of the tracks whose updates are here; later passes keep only the first,
        the last and the greatest smoothed speed.  None where all are here.
    """

    updates: list[TrackUpdate] = field(default_factory=list)
    passes: list[PassResult] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    wall_s: float = 0.0
    cpu_s: float = 0.0
    kept: Optional[frozenset[int]] = None

    def add(self, step: Step, open_tracks: Collection[int], most_updates: Optional[int]) -> None:
        """
        Add the results of a pair.

        :param step: updates and passes.
        :param open_tracks: numbers of the tracks whose passes are still to come.
        :param most_updates: number of updates to hold; None for all.
        """
        self.passes += step.passes if self.kept is None else map(_shortened, step.passes)
        if self.kept is not None:
            return
        self.updates += step.updates
        if most_updates is not None and len(self.updates) > most_updates:
            self.forget_others({p.track for p in self.passes} | set(open_tracks))
            if len(self.updates) > most_updates // 2:
                self.kept = frozenset(p.track for p in self.passes)
                self.forget_others(self.kept)

    def forget_others(self, tracks: Collection[int]) -> None:
        """Discard the updates of all tracks except the given ones."""
        self.updates = [u for u in self.updates if u.track in tracks]


def run(pipeline: SpeedPipeline, pairs: Iterable[StereoPair],
        observe: Optional[Observer] = None, sink: Optional[Sink] = None,
        most_updates: int = KEPT_UPDATES, so_far: Optional[Run] = None,
        relay: Optional[Relay] = None, later: Optional[Later] = None) -> Run:
    """
    Measure every pair of a stream.

    :param pipeline: a new pipeline.
    :param pairs: pairs in order of stamps.
    :param observe: called with each pair and its results.
    :param sink: takes all updates and passes as they come; None to hold all of them.
    :param most_updates: number of updates to hold where there is a sink; passes are then held
        without their traces, except those that end with the stream.
    :param so_far: results of earlier pairs, to which those of this run are added.
    :param relay: keeps the results of pairs, and lets other pipelines continue.
    :param later: measures the passes of the pipeline, where that does not do it itself.  The
        results of a pair are reported when its passes are measured, in the same order.
    :raises InputError: a pair that cannot be used.
    """
    out = Run() if so_far is None else so_far
    telling = _Telling(out, observe, sink, most_updates, relay)
    for pair in pairs:
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        step = pipeline.process(pair)
        out.wall_s += time.perf_counter() - wall_s
        out.cpu_s += time.process_time() - cpu_s
        out.stamps_ns.append(pair.stamp_ns)
        open_tracks = () if sink is None and relay is None else pipeline.open_tracks
        telling.add(_Untold(pair, step, open_tracks, later.pop() if later else ()))
        if relay is not None and relay.ends(pair, pipeline):
            telling.finish()
            pipeline = relay.begin(pipeline, out)
    telling.finish()
    wall_s = time.perf_counter()
    last = Step([], pipeline.finish())
    out.wall_s += time.perf_counter() - wall_s
    gather(out, last, () if sink is None else pipeline.open_tracks, sink, most_updates)
    out.passes.sort(key=lambda p: p.track)
    # Detections that did not become a pass are not reported.
    out.forget_others({p.track for p in out.passes})
    return out


@dataclass(frozen=True, eq=False)
class _Untold:
    """
    The results of a pair that are not reported yet.

    :param pair: the pair.
    :param step: its results without the passes that are still being measured.
    :param open_tracks: numbers of the tracks whose passes are still to come after it.
    :param passes: futures of its passes that are being measured.
    """

    pair: StereoPair
    step: Step
    open_tracks: Collection[int]
    passes: Sequence[Future[PassResult]]

    @property
    def is_whole(self) -> bool:
        """Return whether all of its passes are measured."""
        return all(one.done() for one in self.passes)

    @property
    def image_bytes(self) -> int:
        """Return the size of its images in bytes."""
        return self.pair.left.nbytes + self.pair.right.nbytes

    def whole(self) -> Step:
        """Return its results with all of its passes, waiting for them where necessary."""
        return Step(self.step.updates, [
            *self.step.passes, *(one.result() for one in self.passes)])


@dataclass(eq=False)
class _Telling:
    """Reports the results of pairs in their order; its parameters are those of :func:`run`."""

    out: Run
    observe: Optional[Observer]
    sink: Optional[Sink]
    most_updates: int
    relay: Optional[Relay]
    untold: deque[_Untold] = field(default_factory=deque)
    untold_bytes: int = 0  # size of their images

    def add(self, one: _Untold) -> None:
        """Add the results of the next pair; report those complete, or waiting beyond limits."""
        self.untold.append(one)
        self.untold_bytes += one.image_bytes
        while self.untold and (
                self.untold[0].is_whole or len(self.untold) > MOST_UNTOLD
                or self.untold_bytes > MOST_UNTOLD_BYTES):
            self._tell_first()

    def finish(self) -> None:
        """Report everything."""
        while self.untold:
            self._tell_first()

    def _tell_first(self) -> None:
        one, waited_s = self.untold.popleft(), time.perf_counter()
        self.untold_bytes -= one.image_bytes
        step = one.whole()
        self.out.wall_s += time.perf_counter() - waited_s
        if self.sink is None:
            gather(self.out, step, (), None)
        else:
            gather(self.out, _untraced(step), one.open_tracks, self.sink, self.most_updates)
        if self.observe is not None:
            self.observe(one.pair, step)
        if self.relay is not None:
            self.relay.tell(one.pair, step, one.open_tracks)


def gather(out: Run, step: Step, open_tracks: Collection[int], sink: Optional[Sink],
           most_updates: int = KEPT_UPDATES) -> None:
    """
    Add the results of a pair to a run.

    :param out: the run.
    :param step: updates and passes.
    :param open_tracks: numbers of the tracks whose passes are still to come.
    :param sink: takes the results too; None to hold all updates.
    :param most_updates: number of updates to hold where there is a sink.
    """
    if sink is None:
        out.add(step, (), None)
    else:
        out.add(step, open_tracks, most_updates)
        sink.add(step.updates, step.passes, open_tracks)


def _untraced(step: Step) -> Step:
    """Return the results of a pair without the traces of its passes, which are large."""
    return Step(step.updates, [replace(p, trace=None) for p in step.passes])


def _shortened(result: PassResult) -> PassResult:
    """Return a pass with only the part of its speed profile that its row in a table needs."""
    speeds = result.smoothed
    if not speeds:
        return result
    some = {min(speeds), max(speeds), max(speeds, key=lambda ns: speeds[ns])}
    return replace(result, smoothed={ns: speeds[ns] for ns in sorted(some)}, smoothed_std={})
