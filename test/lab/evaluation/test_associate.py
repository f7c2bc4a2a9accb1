# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Tracks and vehicles are matched one to one by their positions."""
from __future__ import annotations

from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.io.truth import VehicleTruth
from stereo_speed.lab.evaluation.associate import (
    distance, match, nearness, one_to_one, support, vehicles_of)

STAMPS = np.arange(8) * 200_000_000


def vehicle(number, x_m, from_z_m=70.0, places=True):
    """Make the truth of a vehicle that approaches at 20 m/s."""
    position = np.column_stack([np.full(8, x_m), np.ones(8), from_z_m - 4.0 * np.arange(8)])
    return VehicleTruth(number, STAMPS, np.full(8, 20.0),
                        position if places else np.full_like(position, np.nan))


def track(truth, off_m=(0.0, 0.0, 0.0), rows=slice(None)):
    """Return the updates of a track beside a vehicle."""
    return [SimpleNamespace(stamp_ns=int(ns), position_m=place + off_m)
            for ns, place in zip(STAMPS[rows], truth.position_m[rows])]


def test_each_vehicle_gets_its_own_track():
    a, b = vehicle(0, -2.0), vehicle(1, 2.0)
    assert match({7: track(b, (0.3, 0, 1)), 9: track(a, (-0.2, 0, -1))}, [a, b]) == {0: 9, 1: 7}


def test_distance_is_in_gates():
    far = vehicle(0, 0.0, from_z_m=170.0)  # 0.15 of 142 to 170 m
    assert distance(track(far, (0, 0, 10.0)), far) == pytest.approx(
        np.quantile(10.0 / (0.15 * far.position_m[:, 2]), 0.25))
    near = vehicle(0, 0.0, from_z_m=24.0)  # 4 m, below 26.7 m
    assert distance(track(near, (0, 0, 2.0)), near) == pytest.approx(0.5)


def test_track_beyond_the_gate_does_not_match():
    a = vehicle(0, 0.0, from_z_m=24.0)
    assert match({1: track(a, (0, 0, 5.0))}, [a]) == {}
    assert match({1: track(a, (0, 0, 3.9))}, [a]) == {0: 1}


def test_one_vehicle_gets_one_of_two_tracks():
    a = vehicle(0, 0.0)
    assert match({1: track(a, (1, 0, 0)), 2: track(a, (0.1, 0, 0))}, [a]) == {0: 2}


def test_track_that_leaves_its_vehicle_later_still_matches():
    a, b = vehicle(0, -2.0), vehicle(1, 2.0, from_z_m=60.0)
    wandering = track(a)[:4] + [SimpleNamespace(stamp_ns=u.stamp_ns, position_m=u.position_m * 3)
                                for u in track(a)[4:]]
    assert match({5: wandering, 6: track(b)}, [a, b]) == {0: 5, 1: 6}


def test_tracks_without_a_common_stamp_do_not_match():
    a = vehicle(0, 0.0)
    late = [SimpleNamespace(stamp_ns=u.stamp_ns + 50_000_000, position_m=u.position_m)
            for u in track(a)]
    assert match({1: late}, [a]) == {}


def test_without_places_the_longest_track_matches_a_single_vehicle():
    a = vehicle(0, 0.0)
    blind = vehicle(0, 0.0, places=False)
    assert match({1: track(a, rows=slice(3)), 2: track(a)}, [blind]) == {0: 2}
    assert match({1: track(a)}, [blind, vehicle(1, 3.0, places=False)]) == {}


def test_sum_of_distances_is_minimal():
    rng = np.random.default_rng(5)
    for _ in range(20):
        truths = [vehicle(k, x) for k, x in enumerate(rng.uniform(-3, 3, 4))]
        tracks = {k: track(truths[k % 4], rng.normal(0, 1.5, 3)) for k in range(4)}
        cost = np.array([[distance(tracks[k], t) for k in tracks] for t in truths])
        found = match(tracks, truths)
        if (cost > 1).any():
            continue
        best = min(sum(cost[i, p[i]] for i in range(4)) for p in permutations(range(4)))
        assert sum(cost[i, found[i]] for i in range(4)) == pytest.approx(best)


def test_pairs_have_the_maximum_sum_of_gains_by_brute_force():
    rng = np.random.default_rng(6)
    for rows, columns in ((1, 4), (4, 2), (3, 3), (0, 2), (2, 0)):
        gain = np.maximum(rng.normal(0.2, 1.0, (rows, columns)), 0.0)
        square = np.zeros((5, 5))
        square[:rows, :columns] = gain
        best = max(square[np.arange(5), p].sum() for p in map(list, permutations(range(5))))
        pairs = one_to_one(gain)
        assert sum(gain[i, j] for i, j in pairs) == pytest.approx(best)
        assert all(gain[i, j] > 0 for i, j in pairs)
        assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)


def test_nearness_gates_by_hand():
    true = np.array([0.0, 0.0, 50.0])
    off = np.array([[0.0, 0, 0], [0.6, 0, 0], [0, 0, 1.5], [0, 1.25, 0], [1.3, 0, 0],
                    [3.7, 0, 0], [0, 0, -8.0], [0.36, 0, 1.2]])
    # 6 % of 50 m is 3 m; a tall one's lower half; beyond the gates; 0.3 and 0.4 are 0.5
    assert nearness(true + off, np.tile(true, (8, 1))) == pytest.approx(
        [1.0, 0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.5])
    assert nearness(true, true) == 1.0


def test_depth_counts_along_the_line_of_sight():
    true = np.array([30.0, 0.0, 40.0])
    assert nearness(true * (1 + 1.5 / 50), true) == pytest.approx(0.5)
    across = np.array([0.8, 0.0, -0.6])  # square to the ray: x alone is to the side
    assert nearness(true + across, true) == pytest.approx(1 - 0.8 / 1.2)


def test_support_is_the_sum_over_common_stamps():
    a = vehicle(0, 0.0)
    assert support(track(a, (0.6, 0, 0)), a) == pytest.approx(4.0)
    late = [SimpleNamespace(stamp_ns=u.stamp_ns + 50_000_000, position_m=u.position_m)
            for u in track(a)]
    assert support(late, a) == 0.0


def test_each_track_is_on_one_vehicle_or_on_none():
    a, b = vehicle(0, -1.85), vehicle(1, 1.85)
    tracks = {3: track(b, rows=slice(4)), 4: track(a), 5: track(b, rows=slice(4, 8)),
              6: track(a, (0, 0, 30.0))}
    assert vehicles_of(tracks, [a, b]) == {3: 1, 4: 0, 5: 1}
    assert vehicles_of(tracks, []) == vehicles_of({}, [a]) == {}


def test_jumping_track_is_on_the_vehicle_it_followed_longer():
    a, b = vehicle(0, -1.85), vehicle(1, 1.85)
    jumping = track(a, rows=slice(3)) + track(b, rows=slice(3, 8))
    assert vehicles_of({1: jumping}, [a, b]) == {1: 1}


def test_track_briefly_on_a_vehicle_is_on_none():
    a = vehicle(0, 0.0)
    brief = track(a, rows=slice(2)) + track(a, (0, 0, 40.0), rows=slice(2, 8))
    assert vehicles_of({1: brief}, [a]) == {}  # two of eight updates are a quarter
    brief = track(a, rows=slice(3)) + track(a, (0, 0, 40.0), rows=slice(3, 8))
    assert vehicles_of({1: brief}, [a]) == {1: 0}
