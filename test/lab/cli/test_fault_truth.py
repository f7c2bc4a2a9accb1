# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Output of nodes is compared with the right vehicle and time, by hand."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.io.truth import VehicleTruth
from stereo_speed.lab.cli.fault_truth import Truth

SECOND, HOUR = 10 ** 9, 3600 * 10 ** 9
STAMPS = 1_700_000_000 * SECOND + SECOND * np.arange(5)


def drives(vehicle, lane_m, from_m, speeds_mps):
    """Return the truth of a vehicle, seen by a level camera whose z axis follows the road."""
    speeds = np.array(speeds_mps, float)
    z_m = from_m - np.concatenate([[0.0], np.cumsum((speeds[1:] + speeds[:-1]) / 2)])
    return VehicleTruth(vehicle, STAMPS, np.abs(speeds),
                        np.stack([np.full(5, lane_m), np.ones(5), z_m], axis=1))


# One brakes from 20 to 12 m/s in the left lane; one drives 30 m/s in the right one.
TRUTH = Truth([drives(7, -1.75, 100.0, [20, 18, 16, 14, 12]), drives(9, 1.75, 150.0, [30] * 5)],
              (HOUR / SECOND, -HOUR / SECOND))


def front(row, vehicle=0):
    """Return the true place of a front in a row of the truth."""
    return TRUTH.vehicles[vehicle].position_m[row]


def places(*rows, off_ns=0, gap_m=(-0.5, 0.0, 1.0)):
    """Return heard places of vehicle_0, at some rows of the truth."""
    return {(int(STAMPS[row]) + off_ns, 'vehicle_0'): tuple(front(row) + gap_m) for row in rows}


def told(speed, off_ns=0, last=4):
    """Return the message of a pass over all five stamps."""
    return {'track': 0, 'speed_mps': speed, 'speed_std_mps': 0.5,
            'first_stamp_ns': int(STAMPS[0]) + off_ns,
            'last_stamp_ns': int(STAMPS[0]) + last * SECOND + off_ns}


def reading(row, speed_mps, off_ns=0):
    return SimpleNamespace(ns=int(STAMPS[0]) + round(row * SECOND) + off_ns,
                           frame_id='vehicle_0', speed_mps=speed_mps, std_mps=0.2)


@pytest.mark.parametrize('off_ns', [0, HOUR, -HOUR, 5_000_000])
@pytest.mark.parametrize('rows', [(0, 1, 2, 3, 4), (0, 4), (0, 1), (3,), (1, 2, 4)])
def test_pass_is_compared_with_its_vehicle_over_its_time(rows, off_ns):
    """However few of its positions are published; also with stamps that are off."""
    heard = places(*rows, off_ns=off_ns)
    assert TRUTH.of_pass(told(16.1, off_ns), heard)[:2] == pytest.approx((0.1, 0.5))


def test_pass_that_ends_beyond_the_truth_has_the_mean_of_what_is_known():
    """Mean of 20, 18, 16, 14, 12 and, where none of its stamps is in the truth, the last one."""
    assert TRUTH.of_pass(told(16.1, last=5), places(3))[:2] == pytest.approx((0.1, 0.5))
    late = 4 * SECOND + 600_000_000
    at = (int(STAMPS[0]) + late, 'vehicle_0')
    assert TRUTH.of_pass(told(12.5, late, last=0), {at: tuple(front(4) - (0, 0, 7.8))})[:2] \
        == pytest.approx((0.5, 0.5))


def test_pass_without_a_position_on_a_vehicle_is_on_none():
    assert TRUTH.of_pass(told(16.0), {}) is None
    assert TRUTH.of_pass(told(16.0), places(0, 1, gap_m=(9.0, 0.0, 0.0))) is None


def test_pass_is_on_a_vehicle_by_half_of_its_positions():
    nowhere = places(0, 1, gap_m=(-9.0, 0.0, 0.0))
    assert TRUTH.of_pass(told(16.0), {**nowhere, **places(2)}) is None
    assert TRUTH.of_pass(told(16.0), {**nowhere, **places(2, 3)})[:2] == pytest.approx((0.0, 0.5))


def test_reading_is_compared_with_the_speed_at_its_own_time():
    assert TRUTH.of_reading(reading(3, 14.5), places(3))[:2] == pytest.approx((0.5, 0.2))
    assert TRUTH.of_reading(reading(3, 14.5), places(2)) is None
    between = {(int(STAMPS[0]) + 3_500_000_000, 'vehicle_0'):
               tuple((front(3) + front(4)) / 2)}
    assert TRUTH.of_reading(reading(3.5, 14.5), between)[:2] == pytest.approx((1.5, 0.2))


@pytest.mark.parametrize('gap_m, found', [
    ((0.0, 0.0, 0.0), True),
    ((1.6, 0.0, 0.0), True),  # in its lane
    ((-1.9, 0.0, 0.0), False),  # beside the road
    ((0.0, -2.0, 0.0), True),  # the screen of a lorry
    ((0.0, -3.0, 0.0), False),
    ((0.0, 0.0, 12.0), True),  # the rear of a bus
    ((0.0, 0.0, 25.0), False),  # behind any vehicle
    ((0.0, 0.0, -1.9), True),  # as uncertain as a position is
    ((0.0, 0.0, -9.0), False)])  # in front of it
def test_place_is_on_a_vehicle_from_its_front_to_its_rear(gap_m, found):
    on = TRUTH.on(int(STAMPS[0]), front(0) + gap_m)
    assert (on is not None and on.vehicle == 0) is found


def test_body_of_a_vehicle_that_shows_its_rear_is_ahead_of_it():
    away = Truth([drives(1, 0.0, 20.0, [-20] * 5)])
    at = away.vehicles[0].position_m[1]
    assert away.on(int(STAMPS[1]), at + (0, 0, 8.0)) is not None
    assert away.on(int(STAMPS[1]), at - (0, 0, 8.0)) is None


def test_place_is_on_the_vehicle_with_the_nearest_front():
    """The second follows 10 m behind the first; a place 7 m behind the first is on it."""
    row = Truth([drives(1, 0.0, 100.0, [20] * 5), drives(2, 0.0, 110.0, [20] * 5)])
    first = row.vehicles[0].position_m[0]
    assert [row.on(int(STAMPS[0]), first + (0, 0, back)).vehicle for back in (4, 7, 9)] \
        == [0, 1, 1]


def test_vehicle_is_followed_for_a_second_beyond_its_truth():
    """It goes on with 13 m/s, the mean of its last two rows."""
    last = front(4)
    for after_s, found in (0.5, True), (0.9, True), (1.1, False):
        on = TRUTH.on(int(STAMPS[4]) + round(after_s * SECOND), last - (0, 0, 13.0 * after_s))
        assert (on is not None) is found


def test_vehicle_that_stands_is_found_at_its_front():
    stands = Truth([VehicleTruth(1, STAMPS, np.zeros(5), np.tile([0.0, 1.0, 40.0], (5, 1)))])
    assert stands.on(int(STAMPS[2]), (0.0, 1.0, 41.0)) == (0, 0)
    assert stands.on(int(STAMPS[2]), (0.0, 1.0, 46.0)) is None


def test_stamps_of_a_clock_that_steps_are_tried_with_its_step():
    """Half a second back at 20 m/s is 10 m, which is on no vehicle without the step."""
    alone = Truth(TRUTH.vehicles[1:])
    steps = Truth(TRUTH.vehicles[1:], (-0.5,))
    heard = {(int(STAMPS[1]) - SECOND // 2, 'vehicle_0'): tuple(front(1, 1))}
    one = reading(0.5, 31.0)
    assert steps.of_reading(one, heard).ns == STAMPS[1]
    assert alone.of_reading(one, heard) is None
    assert steps.of_reading(one, heard)[:2] == pytest.approx((1.0, 0.2))
