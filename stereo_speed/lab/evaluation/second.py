# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Agreement of the second estimate with right first ones, and its detection of wrong ones.

A first estimate is made wrong on purpose by tracking the vehicle with a speed that is wrong by a
given share: from the first pair on, the region given to the second estimate moves away from the
vehicle along the lane, and the speed that it is compared with has that error.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Mapping, Optional, Sequence

import numpy as np

from .accuracy import drawn_of
from .labeled_sequence import LabeledSequence, LineKnowledge, simulated_sequence
from .metrics import greatest, mean, rms, std
from .tables import Cell, mph, shown, signed, Table, table_by_kind
from ...batch.job import Job, Result
from ...core.passes import PassResult, SecondEstimate, time_shares, Verdict
from ...core.records import Array, StereoPair, TrackUpdate
from ...core.tracker_config import TrackerConfig
from ...geometry.rig import StereoRig
from ...pipeline.config import PipelineConfig
from ...pipeline.pipeline import Step
from ...pipeline.run import run
from ...road.lanes import LanePath
from ...second.estimate import compared, SecondOpinion
from ...survey.reference import error_limit_mps

Follow = Sequence[tuple[StereoPair, TrackUpdate]]

COLUMNS = ('', 'passes measured', 'with a second estimate', 'mean error of the second, mph',
           'sd, mph', 'max, mph', 'r.m.s. of error/σ', 'r.m.s. of difference/σ',
           'right passes rejected', 'right passes not compared', 'wrong passes rejected',
           'wrong passes not compared', 'wrong passes accepted')


@dataclass(frozen=True, kw_only=True)
class SecondRun:
    """
    Both estimates of a pass.

    :param kinds: groups that it belongs to: heading to kind.
    :param first_mps: first estimate; None where it rejected the pass.
    :param first_std_mps: its 1-sigma.
    :param truth_mps: mean of the truth over the same time.
    :param second_mps: second estimate; None where there is none.
    :param second_std_mps: its 1-sigma.
    :param rejected: whether the two disagree; None where they are not compared.
    :param wrong: for each falsified first estimate, whether it was rejected; None where there was
        no second one to compare with.
    """

    kinds: Mapping[str, str]
    first_mps: Optional[float] = None
    first_std_mps: Optional[float] = None
    truth_mps: float = np.nan
    second_mps: Optional[float] = None
    second_std_mps: Optional[float] = None
    rejected: Optional[bool] = None
    wrong: Sequence[Optional[bool]] = ()

    @property
    def is_right(self) -> bool:
        """Return whether the first estimate is within the limits of error."""
        if self.first_mps is None:
            return False
        return abs(self.first_mps - self.truth_mps) <= error_limit_mps(self.truth_mps)


def second_job(parameters: Mapping[str, Any]) -> Mapping[str, Any]:
    """Simulate one pass and estimate it twice; runs in a worker process."""
    number, seed, config = parameters['number'], parameters['seed'], TrackerConfig()
    sequence = simulated_sequence(drawn_of(parameters).config, (seed, number),
                                  LineKnowledge(parameters['lines']))
    # The first estimate is needed for rejected passes too.
    lenient = replace(config, second=replace(
        config.second, most_sigmas=100.0, most_difference_mps=100.0))
    follow: dict[int, list[tuple[StereoPair, TrackUpdate]]] = {}

    def keep(pair: StereoPair, step: Step) -> None:
        for update in step.updates:
            follow.setdefault(update.track, []).append((pair, update))
    done = run(sequence.site.pipeline(PipelineConfig(lenient), sequence.annotations, seed=number),
               sequence.pairs, keep)
    if not done.passes or done.passes[0].verdict is not Verdict.MEASURED:
        return {'truth_mps': float(np.nanmean(sequence.truths[0].speed_mps))}
    result = done.passes[0]
    second = result.second or SecondEstimate(None, None, 0)
    stamps = sorted(result.smoothed)
    return {
        'first_mps': result.speed_mps, 'first_std_mps': result.speed_std_mps,
        'truth_mps': float(time_shares(stamps) @ sequence.truths[0].speed_at(stamps)),
        'second_mps': second.speed_mps, 'second_std_mps': second.speed_std_mps,
        'rejected': _is_rejected(result, config),
        'wrong': [wrong_is_rejected(result, follow[result.track], sequence, config, share)
                  for share in parameters['wrong_shares']]}


def wrong_is_rejected(result: PassResult, follow: Follow, sequence: LabeledSequence,
                      config: TrackerConfig, share: float) -> Optional[bool]:
    """
    Return whether a pass with a falsified first estimate is rejected.

    :param result: a measured pass with a right speed.
    :param follow: each pair, with the vehicle's update in it.
    :param share: share of the speed by which the first estimate is falsified.
    :return: whether it is rejected; None where there is no second estimate to compare with.
    """
    rig, lane = sequence.site.rig, sequence.site.lanes[follow[0][1].lane]
    opinion, start_m = SecondOpinion(rig, lane, config), follow[0][1].s_m
    for pair, update in follow:
        regions = moved_region(rig, lane, update, share * (update.s_m - start_m))
        opinion.take(pair.triggered(config.trigger_tolerance_s), *regions)
    second = opinion.estimate(sorted(result.smoothed))
    if result.speed_mps is None:
        return None
    return _is_rejected(replace(result, second=second, speed_mps=(1 + share) * result.speed_mps),
                        config)


def moved_region(rig: StereoRig, lane: LanePath, update: TrackUpdate, ahead_m: float
                 ) -> tuple[Array, Array]:
    """
    Return the corners (4, 2) of a front, moved along its lane, in both raw views, px.

    :param update: update of the track, with the front's position.
    :param ahead_m: distance to move it.
    """
    rays, heading = rig.left.rays(update.quad_left_px), update.axes[:, 0]
    corners = rays * ((update.position_m @ heading) / (rays @ heading))[:, None]
    s_m = np.array([update.s_m, update.s_m + ahead_m])
    (here, there), (before, after) = lane.path.position(s_m), lane.path.frame(s_m)
    corners = there + (corners - here) @ before @ after.T
    left, right, _, _ = rig.project(corners)
    return left, right


def _is_rejected(result: PassResult, config: TrackerConfig) -> Optional[bool]:
    """Return whether the estimates disagree; None where there is no second one."""
    told = compared(result, config.second)
    if told.second is None or told.second.speed_mps is None:
        return None
    return told.verdict is Verdict.REJECTED


def gather_second(jobs: Sequence[Job], results: Sequence[Result]) -> list[SecondRun]:
    """Return each pass with both of its estimates, without failed jobs."""
    return [SecondRun(kinds=drawn_of(job.parameters).kinds, **result.value)
            for job, result in zip(jobs, results) if result.value is not None]


def second_table(passes: Sequence[SecondRun]) -> Table:
    """Return a row for all passes, then one for each kind of them."""
    return table_by_kind(passes, COLUMNS, _row)


def _row(name: str, passes: Sequence[SecondRun]) -> list[Cell]:
    measured = [p for p in passes if p.first_mps is not None]
    both = [p for p in measured if p.second_mps is not None]
    right = [p for p in measured if p.is_right]
    wrong = [found for p in right for found in p.wrong]
    rows = np.array([(p.first_mps, p.first_std_mps, p.second_mps, p.second_std_mps, p.truth_mps)
                     for p in both], dtype=float).reshape(-1, 5)
    first, first_std, second, second_std, truth = rows.T
    error, difference = second - truth, second - first
    return [name, len(measured), f'{len(both)} of {len(measured)}',
            signed(mean(error)), shown(mph(std(error)), 3),
            shown(mph(greatest(error)), 3),
            rms(error / second_std), rms(difference / np.hypot(first_std, second_std)),
            *(f'{sum(p.rejected is found for p in right)} of {len(right)}'
              for found in (True, None)),
            *(f'{wrong.count(found)} of {len(wrong)}' for found in (True, None, False))]


def wrong_firsts(passes: Sequence[SecondRun]) -> tuple[int, int]:
    """Return how many first estimates exceed the limits of error, and how many are rejected."""
    wrong = [p for p in passes if p.first_mps is not None and not p.is_right]
    return len(wrong), sum(p.rejected is True for p in wrong)


def second_rows(passes: Sequence[SecondRun]) -> Table:
    """Return a row for every pass, as data."""
    kinds = list(passes[0].kinds) if passes else []
    return Table(title='', columns=(*kinds, 'truth_mps', 'first_mps', 'first_std_mps',
                                    'second_mps', 'second_std_mps', 'rejected',
                                    'wrong_rejected', 'wrong_not_compared'),
                 rows=[[*(p.kinds[k] for k in kinds), p.truth_mps, p.first_mps, p.first_std_mps,
                        p.second_mps, p.second_std_mps, int(p.rejected is True),
                        list(p.wrong).count(True), list(p.wrong).count(None)] for p in passes])
