# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Counts of the measuring nodes, and their report on ``/diagnostics``."""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
import time
from typing import Callable, Optional

import numpy as np

from .health import ERROR, State, Tally, WARN
from ..core.stamp_watch import StampWatch
from ..pipeline.pipeline import SpeedPipeline
from ..pipeline.stream_doubt import StreamDoubt
from ..steadying.report import steadiness_summary, warning

_LATENCIES = 300  # number of newest pairs whose latencies are kept
STAMPS_UNKNOWN = 'stamps not checked yet, as no pair is measured'
_HARDLY = 0.5  # share of hurried pairs above which the machine is reported to be too slow
_LAG_KNOWN_S = 2e-3  # 1-sigma of the view lag below which it counts as known


@dataclass
class Counts:
    """
    Counts of pairs by what was done with them, and of other events.

    :param measured: pairs that the pipeline has processed.
    :param hurried: measured pairs that were hurried.
    :param skipped: pairs that were skipped because the machine did not keep up.
    :param early: pairs that were too old when measuring began: they had waited for the
        calibration, or while the pipeline was made.
    :param withheld: pairs that must not be measured, for example because the rig has moved.
    :param frozen: pairs of which an image repeats the previous one.
    :param repeated: pairs with the stamp of the previous one.
    :param failed: pairs and passes that failed by an internal error.
    :param resets: jumps of time.
    :param passes: published passes.
    :param latencies_s: times of the newest pairs from arrival to publication, s.
    """

    measured: Tally = field(default_factory=Tally)
    hurried: Tally = field(default_factory=Tally)
    skipped: Tally = field(default_factory=Tally)
    early: Tally = field(default_factory=Tally)
    withheld: int = 0
    frozen: Tally = field(default_factory=Tally)
    repeated: int = 0
    failed: Tally = field(default_factory=Tally)
    resets: Tally = field(default_factory=Tally)
    passes: int = 0
    latencies_s: deque[float] = field(default_factory=lambda: deque(maxlen=_LATENCIES))

    def tell(self, state: State) -> None:
        """Add the counts, and warnings that follow from them, to a state."""
        state.values.update(
            pairs=self.measured.total, passes=self.passes,
            measured_hz=round(self.measured.rate_hz, 2), hurried=self.hurried.total,
            skipped=self.skipped.total, early=self.early.total, withheld=self.withheld,
            frozen=self.frozen.total, failed=self.failed.total, resets=self.resets.total,
            repeated=self.repeated)
        latencies_s = list(self.latencies_s)  # another thread adds to them
        if latencies_s:
            state.values.update({f'latency_p{q}_s': round(float(np.percentile(latencies_s, q)), 4)
                                 for q in (50, 95)})
        if self.resets.recent:
            state.find(WARN, 'stamps jumped back: all passes ended')
        if self.skipped.recent:
            state.find(WARN, f'measuring does not keep up: {self.skipped.recent} pairs skipped')
        if self.early.recent:
            state.find(WARN, f'pairs were too old when measuring began: {self.early.recent}')
        if self.hurried.recent > _HARDLY * self.measured.recent:
            state.find(WARN, 'measuring barely keeps up: most pairs are hurried')
        if self.frozen.recent:
            state.find(WARN, f'{self.frozen.recent} pairs withheld: an image is identical to '
                       'the previous one')
        if self.failed.recent:
            state.find(ERROR, f'measuring failed {self.failed.recent} times')


class ClockSteps:
    """
    Counts the steps of the cameras' clock across pipelines.

    :param clock: steady time of this machine, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._tally, self._known = Tally(clock), 0
        self._watch: Optional[StampWatch] = None

    def tell(self, pipeline: SpeedPipeline, state: State) -> None:
        """Add clock steps to a state."""
        watch = pipeline.doubt.stamps
        if watch is not self._watch:  # another pipeline counts from 0 again
            self._watch, self._known = watch, 0
        self._tally.add(watch.steps - self._known)
        self._known = watch.steps
        state.values['clock_steps'] = watch.steps
        if self._tally.recent:
            state.find(WARN, f'the clock stepped by {watch.last_step_s * 1e3:+.1f} ms: passes at '
                       'that moment are rejected')


def tell_stamps(pipeline: SpeedPipeline, state: State) -> None:
    """Add the evenness of the stamps, and the gap between those of the views, to a state."""
    if pipeline.uneven_stamps_s is not None:
        off_ms = pipeline.uneven_stamps_s * 1e3
        state.values['uneven_ms'] = round(off_ms, 3)
        state.find(WARN, f'stamps deviate from an even pace by {off_ms:.1f} ms: 1-sigmas are '
                   'larger')
    lag = pipeline.doubt.lag.state
    if lag is None:
        return
    state.values.update(gap_ms=round(lag.gap_s * 1e3, 3), looks=lag.looks,
                        correction_ms=round(lag.correction_s * 1e3, 3),
                        lag_std_ms=round(lag.std_s * 1e3, 3))
    say = f'stamps of the views are {lag.gap_s * 1e3:.1f} ms apart'
    if lag.std_s > _LAG_KNOWN_S:
        state.find(ERROR, f'{say}, and it is not known yet whether the exposures are: readings '
                   'are withheld')
    elif lag.correction_s or lag.constant:
        state.find(WARN, f'{say}, which the images contradict: the right stamps are corrected')
    else:
        state.find(WARN, f'{say}, as the exposures are')


def tell_rig(doubt: StreamDoubt, state: State) -> None:
    """Add sway and drift of the rig, and the focus of its cameras, to a state."""
    focus, steadier = doubt.focus.state, doubt.steadier
    state.values.update((f'focus_{key}', value) for key, value in focus.summary().items())
    if out_of_focus := focus.warning():
        state.find(WARN, out_of_focus)
    if steadier is None:
        return
    state.values.update((f'rig_{key}', value)
                        for key, value in steadiness_summary(steadier.state()).items())
    if wrong := warning(steadier):
        state.find(WARN, wrong)
