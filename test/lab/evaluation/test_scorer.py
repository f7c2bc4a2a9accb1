# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reports are compared with the truth, stamp by stamp."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.core.passes import PassResult, Verdict
from stereo_speed.core.records import TrackState
from stereo_speed.io.truth import truth_of_rows
from stereo_speed.lab.evaluation.scorer import beside_truth, by_track, SequenceRun, vehicle_run

TRUTHS = truth_of_rows([{'stamp_ns': k, 'vehicle': 0, 'speed': 10.0 + k, 'x': 0.0, 'y': 1.0,
                         'z': 50.0 - k} for k in range(0, 40000, 10000)])


def update(track, stamp_ns, z_m, speed, confirmed=True):
    return SimpleNamespace(
        track=track, stamp_ns=stamp_ns, position_m=np.array([0.0, 1.0, z_m]), speed_mps=speed,
        state=TrackState.CONFIRMED if confirmed else TrackState.COASTING)


def passed(track=8, smoothed=None, **changes):
    return PassResult(**{
        'track': track, 'lane': 'a', 'first_ns': 10000, 'last_ns': 20000, 'pairs': 2,
        'speed_mps': 12.0, 'speed_std_mps': 0.1, 'verdict': Verdict.MEASURED, 'reason': '',
        'smoothed': smoothed or {}, 'smoothed_std': {}, **changes})


def test_readings_and_pass_are_compared_with_the_truth_of_their_pairs():
    updates = [update(8, k, 50.0 - k, 11.0, k > 0) for k in range(0, 50000, 10000)]
    updates.append(update(9, 0, 500.0, 3.0))  # on nothing
    run, = beside_truth(updates, [passed(smoothed={10000: 11.0, 20000: 12.0})], TRUTHS)
    assert run.truth_mps == [10.0, 10010.0, 20010.0, 30010.0, None]
    assert run.confirmed == [False, True, True, True, True]
    assert run.pass_truth_mps == 15010.0  # over the pairs of the pass alone
    assert run.last_quarter_ns == 30000


def test_pass_without_smoothed_speeds_counts_the_pairs_of_its_duration():
    track = [update(8, k, 50.0 - k, 11.0) for k in range(0, 40000, 10000)]
    assert vehicle_run(TRUTHS[0], track, passed()).pass_truth_mps == 15010.0


def test_vehicle_without_a_track_has_no_readings():
    run, = beside_truth([], [], TRUTHS)
    assert (run.stamps_ns, run.verdict, run.measured) == ([], '', False)
    assert run.last_quarter_ns == 30000


@pytest.mark.parametrize(('changes', 'wanted'), [
    ({}, True), ({'verdict': Verdict.REJECTED, 'speed_mps': None}, False),
    ({'speed_mps': None}, False)], ids=['measured', 'rejected', 'speechless'])
def test_measured_means_a_verdict_with_a_speed(changes, wanted):
    assert vehicle_run(TRUTHS[0], [update(8, 0, 50.0, 1.0)], passed(**changes)).measured is wanted


def test_updates_are_collected_by_track_in_order():
    tracks = by_track([update(2, 0, 1.0, 1.0), update(1, 0, 2.0, 1.0), update(2, 1, 3.0, 1.0)])
    assert {n: [u.position_m[2] for u in us] for n, us in tracks.items()} == {2: [1, 3], 1: [2]}


def test_run_round_trips_through_json():
    run = SequenceRun(vehicles=beside_truth(
        [update(8, k, 50.0 - k, 11.0) for k in range(0, 50000, 10000)], [passed()], TRUTHS),
        cpu_ms=1.5)
    assert SequenceRun.from_json(run.to_json()) == run
