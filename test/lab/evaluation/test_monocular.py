# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Scores of the monocular tracker worked by hand."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.batch.job import Result
from stereo_speed.lab.evaluation.monocular import (
    score_target, scores_of, Setting, summary_table, survival_rate, target_table, TargetScore)
from stereo_speed.monocular.boxes import Target, TargetEstimate, TargetState


def estimate(frame, box):
    return TargetEstimate(frame=frame, id=1, state=TargetState.TRACKED, box_px=np.array(box),
                          angle_rad=0.0, distance_px=0.0, distance_rate_px=0.0, similarity=1.0,
                          velocity_px=np.zeros(2))


def test_score_worked_by_hand():
    """Overlaps 1, 1/3 and none in frames 2, 3 and 4; frame 5 is beyond the video."""
    target = Target(id=1, frame=1, box_px=np.array([0.0, 0, 10, 10]))
    truth = {f: np.array([0.0, 0, 10, 10]) for f in range(1, 6)}
    found = {1: estimate(1, [50.0, 0, 10, 10]), 2: estimate(2, [0.0, 0, 10, 10]),
             3: estimate(3, [5.0, 0, 10, 10])}
    score = score_target(target, found, truth, 1, 4)
    assert score == TargetScore(kept=False, overlap=pytest.approx((1 + 1 / 3) / 3),
                                followed=pytest.approx(2 / 3), astray=0.0)
    assert score_target(target, found, truth, 2, 4).kept  # frame 3 alone
    assert score_target(target, found, {1: truth[1]}, 1, 4) is None


def test_kept_share_and_its_error_by_hand():
    """Two seeds keep 2 of 2 and 1 of 2: mean 3/4, standard error 1/4."""
    scores = {i: [TargetScore(kept=k, overlap=0.5, followed=1.0, astray=0.0) for k in kept]
              for i, kept in ((1, (True, True)), (2, (True, False)))}
    assert survival_rate(scores) == (pytest.approx(0.75), pytest.approx(0.25))
    assert all(np.isnan(survival_rate({})))


def result(seed, kept):
    """Return a job's result: two settings, of which the second kept target 4 only."""
    score = {'overlap': 0.5, 'followed': 0.75, 'astray': 0.25}
    return Result(key=str(seed), value={
        '0': {'3': {'kept': kept, **score}, '4': {'kept': True, **score}},
        '1': {'4': {'kept': True, **score}}})


def test_tables_of_two_seeds_by_hand():
    """The first setting keeps 1 of 2 and 2 of 2, the second always its only target."""
    settings = [Setting(tracker='environment', particles=150, stride=1),
                Setting(tracker='plain', particles=300, stride=2)]
    results = [result(0, False), result(1, True), Result(key='2', error='broken')]
    assert {i: [s.kept for s in v] for i, v in scores_of(results, 0).items()} == {
        3: [False, True], 4: [True, True]}
    table = summary_table('title', settings, results)
    assert table.rows[0] == ['environment', 150, 1, 75.0, pytest.approx(25.0), 75.0, 25.0, 0.5]
    assert table.rows[1][:5] == ['plain', 300, 2, 100.0, 0.0]
    assert table.note.startswith('2 seeds')
    assert target_table('title', settings, results).rows == [
        [3, 50.0, 0.5, None, None], [4, 100.0, 0.5, 100.0, 0.5]]
