# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Scores of many vehicles, by hand."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.core.passes import PassResult, Verdict
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.lab.evaluation.traffic import score_traffic, traffic_table, TrafficRules

PERIOD_NS = 100_000_000


def _truth(k, vehicle, lane=0, speed=20.0, **changes):
    return {'stamp_ns': k * PERIOD_NS, 'vehicle': vehicle, 'speed': speed, 'lane': lane,
            'lateral': 0.0, 'x': 3.7 * lane, 'y': 1.0, 'z': 70.0 - 2.0 * k, 'width_px': 60.0,
            'visible': 1.0, 'in_view': True, **changes}


def _update(k, track, lane=0, speed=20.1, state=TrackState.CONFIRMED, ahead_m=0.0,
            name=None):
    return TrackUpdate(
        stamp_ns=k * PERIOD_NS, track=track, lane=name or f'lane_{lane}', state=state,
        speed_mps=speed, speed_std_mps=0.1, s_m=0.0, lateral_m=0.0,
        position_m=np.array([3.7 * lane, 1.0, 70.3 - 2.0 * k + ahead_m]),
        position_cov_m2=np.eye(3), axes=np.eye(3), quad_left_px=np.zeros((4, 2)),
        quad_right_px=np.zeros((4, 2)))


def _pass(track, speed=20.1, std=0.1, verdict=Verdict.MEASURED):
    return PassResult(
        track=track, lane='lane_0', first_ns=0, last_ns=PERIOD_NS, pairs=2,
        speed_mps=speed if verdict is Verdict.MEASURED else None, speed_std_mps=std,
        verdict=verdict, reason='' if verdict is Verdict.MEASURED else 'too_short', smoothed={},
        smoothed_std={})


def _score(pairs, passes, rules=TrafficRules()):
    return score_traffic([row for rows, _ in pairs for row in rows],
                         [update for _, updates in pairs for update in updates], passes,
                         ['lane_0', 'lane_1', 'lane_2'], rules)


def test_one_vehicle_one_track():
    score = _score([([_truth(k, 7)], [_update(k, 0)]) for k in range(12)], [_pass(0)])
    assert (score.vehicles, score.once, score.split, score.rejected, score.missed,
            score.false_tracks, score.wrong, score.brief) == (1, 1, 0, 0, 0, 0, 0, 0)
    assert (score.passes.mean_mps, score.passes.sigma_ratio) == pytest.approx((0.1, 1.0))
    assert score.live_rms_mps == pytest.approx(0.1)
    assert (score.lanes_wrong, score.lanes_sure) == (0, 12)


def test_neighbours_are_separated_and_a_swap_is_visible():
    pairs = [([_truth(k, 0), _truth(k, 1, lane=1)], [_update(k, 5, lane=1), _update(k, 6)])
             for k in range(12)]
    score = _score(pairs, [_pass(5, 20.0), _pass(6, 21.0)])
    assert score.once == 2 and score.false_tracks == 0 and score.wrong == 1
    assert (score.passes.mean_mps, score.passes.max_mps) == pytest.approx((0.5, 1.0))


def test_split_rejected_missed_false_and_brief_tracks():
    pairs = []
    for k in range(20):
        truth = [_truth(k, 0), _truth(k, 1, lane=1), _truth(k, 2, lane=2)]
        if k < 3:
            truth.append(_truth(k, 3, lane=2, z=30.0))  # seen too briefly
        updates = [_update(k, 0 if k < 10 else 4),  # two tracks of one vehicle
                   _update(k, 1, lane=1),
                   _update(k, 2, lane=0, ahead_m=-30.0),  # on nothing
                   _update(k, 3, lane=1, ahead_m=25.0, state=TrackState.TENTATIVE)]
        pairs.append((truth, updates))
    score = _score(pairs, [_pass(0), _pass(4), _pass(1, verdict=Verdict.REJECTED), _pass(2),
                           _pass(3, verdict=Verdict.REJECTED)])
    assert (score.vehicles, score.once, score.split, score.rejected, score.missed,
            score.false_tracks, score.brief) == (3, 0, 1, 1, 1, 1, 1)


def test_lanes_count_only_away_from_the_lines():
    pairs = [([_truth(k, 0, lateral=1.7 if k < 4 else 0.2)], [_update(k, 0, name='lane_1')])
             for k in range(10)]
    score = _score(pairs, [_pass(0)])
    assert (score.lanes_wrong, score.lanes_sure) == (6, 6)


def test_occluded_far_or_cut_vehicles_need_not_be_measured():
    for changes in ({'visible': 0.3}, {'width_px': 20.0}, {'in_view': False}):
        score = _score([([_truth(k, 0, **changes)], []) for k in range(20)], [])
        assert (score.vehicles, score.missed, score.brief) == (0, 0, 1)


def test_rules_decide_which_vehicles_count_and_what_is_wrong():
    pairs = [([_truth(k, 0, width_px=30.0)], [_update(k, 0)]) for k in range(12)]
    assert _score(pairs, [_pass(0)]).vehicles == 0
    near = _score(pairs, [_pass(0)], TrafficRules(seen_px=30.0))
    assert (near.vehicles, near.once, near.wrong) == (1, 1, 0)
    assert _score(pairs, [_pass(0)], TrafficRules(wrong_mps=0.09)).wrong == 1
    assert _score(pairs, [_pass(0)], TrafficRules(seen_px=30.0, seen_s=1.2)).vehicles == 0
    assert _score(pairs, [_pass(0)], TrafficRules(seen_px=30.0, seen_pairs=13)).vehicles == 0


def test_table_of_one_stream_by_hand():
    pairs = [([_truth(k, 7)], [_update(k, 0, speed=20.0 + 0.44704)]) for k in range(12)]
    score = _score(pairs, [_pass(0, 20.0 - 0.044704, 0.05)])
    assert traffic_table('a', score, 12.34).markdown().splitlines()[-1] == (
        '| a | 1 | 1 | 0 | 0 | 0 | 0 | 0 | -0.100 ± 0.000 | 0.100 | 0.89 | 1.00 | 0 of 12 | 0 '
        '| 12.3 |')
    nothing = _score([([_truth(k, 7)], []) for k in range(12)], [])
    assert traffic_table('b', nothing, 1.0).markdown().splitlines()[-1] == (
        '| b | 1 | 0 | 0 | 0 | 1 | 0 | 0 | - | - | - | - | 0 of 0 | 0 | 1.0 |')
