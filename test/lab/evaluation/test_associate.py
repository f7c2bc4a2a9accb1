# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Tracks and vehicles are matched one to one by their places."""
from __future__ import annotations

from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.io.truth import VehicleTruth
from stereo_speed.lab.evaluation.associate import distance, match

STAMPS = np.arange(8) * 200_000_000


def vehicle(number, x_m, from_z_m=70.0, places=True):
    """Make the truth of a vehicle that comes along at 20 m/s."""
    position = np.column_stack([np.full(8, x_m), np.ones(8), from_z_m - 4.0 * np.arange(8)])
    return VehicleTruth(number, STAMPS, np.full(8, 20.0),
                        position if places else np.full_like(position, np.nan))


def track(truth, off_m=(0.0, 0.0, 0.0), rows=slice(None)):
    """Make the updates of a track beside a vehicle."""
    return [SimpleNamespace(stamp_ns=int(ns), position_m=place + off_m)
            for ns, place in zip(STAMPS[rows], truth.position_m[rows])]


def test_each_gets_its_own():
    a, b = vehicle(0, -2.0), vehicle(1, 2.0)
    assert match({7: track(b, (0.3, 0, 1)), 9: track(a, (-0.2, 0, -1))}, [a, b]) == {0: 9, 1: 7}


def test_distance_is_told_in_gates():
    far = vehicle(0, 0.0, from_z_m=170.0)  # 0.15 of 142 to 170 m
    assert distance(track(far, (0, 0, 10.0)), far) == pytest.approx(
        np.quantile(10.0 / (0.15 * far.position_m[:, 2]), 0.25))
    near = vehicle(0, 0.0, from_z_m=24.0)  # 4 m, below 26.7 m
    assert distance(track(near, (0, 0, 2.0)), near) == pytest.approx(0.5)


def test_what_is_beyond_the_gate_does_not_match():
    a = vehicle(0, 0.0, from_z_m=24.0)
    assert match({1: track(a, (0, 0, 5.0))}, [a]) == {}
    assert match({1: track(a, (0, 0, 3.9))}, [a]) == {0: 1}


def test_one_vehicle_gets_one_of_two_tracks():
    a = vehicle(0, 0.0)
    assert match({1: track(a, (1, 0, 0)), 2: track(a, (0.1, 0, 0))}, [a]) == {0: 2}


def test_a_track_that_leaves_its_vehicle_later_is_still_its():
    a, b = vehicle(0, -2.0), vehicle(1, 2.0, from_z_m=60.0)
    wandering = track(a)[:4] + [SimpleNamespace(stamp_ns=u.stamp_ns, position_m=u.position_m * 3)
                                for u in track(a)[4:]]
    assert match({5: wandering, 6: track(b)}, [a, b]) == {0: 5, 1: 6}


def test_no_common_stamp_no_match():
    a = vehicle(0, 0.0)
    late = [SimpleNamespace(stamp_ns=u.stamp_ns + 50_000_000, position_m=u.position_m)
            for u in track(a)]
    assert match({1: late}, [a]) == {}


def test_without_places_the_longest_track_is_taken_for_a_single_vehicle():
    a = vehicle(0, 0.0)
    blind = vehicle(0, 0.0, places=False)
    assert match({1: track(a, rows=slice(3)), 2: track(a)}, [blind]) == {0: 2}
    assert match({1: track(a)}, [blind, vehicle(1, 3.0, places=False)]) == {}


def test_the_sum_of_distances_is_the_least():
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
