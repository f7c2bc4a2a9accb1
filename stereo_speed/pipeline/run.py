# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""From a stream of pairs to the results of a run: the one loop that does it."""
from __future__ import annotations

from dataclasses import dataclass, field
import time
from typing import Callable, Iterable, Optional

from .pipeline import SpeedPipeline, Step
from ..core.records import PassResult, StereoPair, TrackUpdate

Observer = Callable[[StereoPair, Step], None]


@dataclass
class Run:
    """
    What a run has gathered.

    :param updates: track updates of what became a vehicle, in time order.
    :param passes: results of the passes, by track.
    :param stamps_ns: stamp of each pair.
    :param wall_s: time spent in the pipeline, s.
    :param cpu_s: processor time spent on pairs, s, without that for passes still open at the end.
    """

    updates: list[TrackUpdate] = field(default_factory=list)
    passes: list[PassResult] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    wall_s: float = 0.0
    cpu_s: float = 0.0


def run(pipeline: SpeedPipeline, pairs: Iterable[StereoPair],
        observe: Optional[Observer] = None) -> Run:
    """
    Measure every pair of a stream.

    :param pipeline: a fresh one.
    :param pairs: in order of stamps.
    :param observe: called with each pair and what came of it.
    :raises InputError: a pair that cannot be used.
    """
    out = Run()
    for pair in pairs:
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        step = pipeline.process(pair)
        out.wall_s += time.perf_counter() - wall_s
        out.cpu_s += time.process_time() - cpu_s
        out.updates += step.updates
        out.passes += step.passes
        out.stamps_ns.append(pair.stamp_ns)
        if observe is not None:
            observe(pair, step)
    wall_s = time.perf_counter()
    out.passes += pipeline.finish()
    out.wall_s += time.perf_counter() - wall_s
    out.passes.sort(key=lambda p: p.track)
    # Of what the detector found, only what became a vehicle is reported.
    vehicles = {p.track for p in out.passes}
    out.updates = [u for u in out.updates if u.track in vehicles]
    return out
