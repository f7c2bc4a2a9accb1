# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""From a stream of pairs to the results of a run: the one loop that does it."""
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
# Pairs that may wait for passes to be measured before they are told, each with its images: these
# take as long as some forty pairs, and longer beside other programs.
MOST_UNTOLD = 80
MOST_UNTOLD_BYTES = 128 << 20  # of their images: 80 pairs of 1024 x 768, and fewer of larger
# A run that has a sink holds so many updates, for pictures: 60 MB.
KEPT_UPDATES = 40_000


class Sink(Protocol):
    """Takes the updates of a run as they come, so that they need not all be held."""

    def add(self, updates: Sequence[TrackUpdate], passes: Sequence[PassResult],
            open_tracks: Collection[int]) -> None:
        """
        Take in what came of one pair.

        :param updates: of the pair.
        :param passes: that are over since the last pair.
        :param open_tracks: numbers of the tracks whose passes are still to come.
        """


class Relay(Protocol):
    """Has one pipeline go on from another, and keeps what came of the pairs."""

    def ends(self, pair: StereoPair, pipeline: SpeedPipeline) -> bool:
        """Return whether another pipeline is to go on after a pair."""

    def begin(self, pipeline: SpeedPipeline, so_far: Run) -> SpeedPipeline:
        """Return the pipeline that goes on from one; all pairs so far have been told."""

    def tell(self, pair: StereoPair, step: Step, open_tracks: Collection[int]) -> None:
        """Take in what came of a pair, in order; see :class:`Sink`."""


@dataclass
class Run:
    """
    What a run has gathered.

    :param updates: track updates of what became a vehicle, in time order.
    :param passes: results of the passes, by track.
    :param stamps_ns: stamp of each pair.
    :param wall_s: time spent in the pipeline, s.
    :param cpu_s: processor time spent on pairs, s, without that for passes still open at the end.
    :param kept: numbers of the tracks whose updates are here; of the other passes only the
        first, the last and the greatest smoothed speed. None where all are here.
    """

    updates: list[TrackUpdate] = field(default_factory=list)
    passes: list[PassResult] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    wall_s: float = 0.0
    cpu_s: float = 0.0
    kept: Optional[frozenset[int]] = None

    def add(self, step: Step, open_tracks: Collection[int], most_updates: Optional[int]) -> None:
        """
        Take in what came of a pair.

        :param step: updates and passes.
        :param open_tracks: numbers of the tracks whose passes are still to come.
        :param most_updates: how many to hold; None for all.
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
        """Forget the updates of all tracks but some."""
        self.updates = [u for u in self.updates if u.track in tracks]


def run(pipeline: SpeedPipeline, pairs: Iterable[StereoPair],
        observe: Optional[Observer] = None, sink: Optional[Sink] = None,
        most_updates: int = KEPT_UPDATES, so_far: Optional[Run] = None,
        relay: Optional[Relay] = None, later: Optional[Later] = None) -> Run:
    """
    Measure every pair of a stream.

    :param pipeline: a fresh one.
    :param pairs: in order of stamps.
    :param observe: called with each pair and what came of it.
    :param sink: takes all updates and passes as they come; without one all are held.
    :param most_updates: how many updates to hold where there is a sink; passes are held without
        their traces then, but those that end with the stream.
    :param so_far: what came of earlier pairs, to be added to.
    :param relay: keeps what came of the pairs, and has other pipelines go on.
    :param later: measures the passes of the pipeline, if that does not.  What came of a pair is
        told when its passes are measured, in the same order.
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
    # Of what the detector found, only what became a vehicle is reported.
    out.forget_others({p.track for p in out.passes})
    return out


@dataclass(frozen=True, eq=False)
class _Untold:
    """
    What came of a pair, before it is told.

    :param pair: the pair.
    :param step: without the passes to come.
    :param open_tracks: numbers of the tracks whose passes are still to come after it.
    :param passes: that are being measured.
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
        """Return the bytes of its images."""
        return self.pair.left.nbytes + self.pair.right.nbytes

    def whole(self) -> Step:
        """Return what came of it, with the passes that it has waited for."""
        return Step(self.step.updates, [
            *self.step.passes, *(one.result() for one in self.passes)])


@dataclass(eq=False)
class _Telling:
    """Tells what came of the pairs, in their order; its parameters are those of :func:`run`."""

    out: Run
    observe: Optional[Observer]
    sink: Optional[Sink]
    most_updates: int
    relay: Optional[Relay]
    untold: deque[_Untold] = field(default_factory=deque)
    untold_bytes: int = 0  # of their images

    def add(self, one: _Untold) -> None:
        """Take in what came of the next pair; tell what can be told, and what has waited long."""
        self.untold.append(one)
        self.untold_bytes += one.image_bytes
        while self.untold and (
                self.untold[0].is_whole or len(self.untold) > MOST_UNTOLD
                or self.untold_bytes > MOST_UNTOLD_BYTES):
            self._tell_first()

    def finish(self) -> None:
        """Tell everything."""
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
    Take in what came of a pair.

    :param out: the run it is added to.
    :param step: updates and passes.
    :param open_tracks: numbers of the tracks whose passes are still to come.
    :param sink: takes them too; without one all are held.
    :param most_updates: how many updates to hold where there is a sink.
    """
    if sink is None:
        out.add(step, (), None)
    else:
        out.add(step, open_tracks, most_updates)
        sink.add(step.updates, step.passes, open_tracks)


def _untraced(step: Step) -> Step:
    """Return what came of a pair without how its passes came about, which holds much."""
    return Step(step.updates, [replace(p, trace=None) for p in step.passes])


def _shortened(result: PassResult) -> PassResult:
    """Return a pass with no more of its profile than its row in a table needs."""
    speeds = result.smoothed
    if not speeds:
        return result
    some = {min(speeds), max(speeds), max(speeds, key=lambda ns: speeds[ns])}
    return replace(result, smoothed={ns: speeds[ns] for ns in sorted(some)}, smoothed_std={})
