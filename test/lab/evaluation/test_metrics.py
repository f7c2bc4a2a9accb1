# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of merit, by hand."""
from __future__ import annotations

import math

import numpy as np
import pytest
from stereo_speed.lab.evaluation.metrics import (
    finite, greatest, lost, mean, mean_and_std, pass_error, pass_figures, reading_figures,
    readings, rms, sigma_share, std)
from stereo_speed.lab.evaluation.scorer import VehicleRun


def run(speeds, truth=20.0, confirmed=None, **changes):
    """Return a run of a vehicle at a constant speed."""
    n = len(speeds)
    return VehicleRun(**{
        'vehicle': 0, 'stamps_ns': list(range(n)), 'speeds_mps': list(speeds),
        'confirmed': confirmed or [True] * n, 'truth_mps': [truth] * n, **changes})


def measured(error, sigma):
    return run([20.0], verdict='measured', pass_mps=20.0 + error, pass_std_mps=sigma,
               pass_truth_mps=20.0)


def test_readings_are_the_confirmed_ones_with_a_truth():
    one = run([25, 21, 19, 20.5], confirmed=[False, True, True, True])
    one.truth_mps[2] = None
    speed, truth = readings(one)
    assert speed.tolist() == [21, 20.5]
    assert truth.tolist() == [20, 20]


def test_figures_of_two_runs_by_hand():
    f = reading_figures([run([21, 20, 19.5, 20.5]), run([18, 20, 20, 21])])
    # errors: 1, 0, -0.5, 0.5, -2, 0, 0, 1
    assert f.mean_mps == pytest.approx(20.0)
    assert f.max_error_mps == 2.0
    assert f.rms_mps == pytest.approx(math.sqrt(6.5 / 8))
    assert f.std_mps == pytest.approx(math.sqrt(6.5 / 8))
    assert f.final_mean_mps == pytest.approx(20.75)
    assert f.final_max_error_mps == 1.0
    assert (f.runs, f.lost, f.truth_mps) == (2, 0, 20.0)


def test_mean_square_is_squared_mean_plus_variance():
    rng = np.random.default_rng(2)
    f = reading_figures([run(20 + rng.normal(0.4, 1, 9)) for _ in range(5)])
    assert f.rms_mps ** 2 == pytest.approx((f.mean_mps - 20) ** 2 + f.std_mps ** 2)
    assert f.max_error_mps >= f.final_max_error_mps


@pytest.mark.parametrize(('confirmed', 'wanted'), [
    ([True] * 8, False),
    ([True] * 6 + [False, False], True),
    ([True] * 6 + [True, False], False),
    ([True] * 5, True),  # its track ended
    ([], True)], ids=['to the end', 'coasting', 'almost', 'ended', 'never'])
def test_run_without_a_reading_in_the_last_quarter_is_lost(confirmed, wanted):
    assert lost(run([20.0] * len(confirmed), confirmed=confirmed,
                    last_quarter_ns=6)) is wanted


def test_vehicle_found_late_and_followed_to_the_end_is_not_lost():
    late = run([20.0] * 3, stamps_ns=[5, 6, 7], last_quarter_ns=6)
    assert not lost(late)


def test_no_runs_give_no_figures():
    f = reading_figures([VehicleRun(vehicle=0)])
    assert f.lost == 1
    assert all(math.isnan(v) for v in (f.mean_mps, f.max_error_mps, f.rms_mps, f.std_mps))
    assert math.isnan(pass_figures([]).max_mps)


def test_figures_of_passes_by_hand():
    rejected = run([20.0], verdict='rejected', reason='uncertain', pass_mps=30.0,
                   pass_std_mps=1.0, pass_truth_mps=20.0)
    f = pass_figures([measured(0.1, 0.1), measured(-0.3, 0.1), measured(0.5, 0.1), rejected])
    assert (f.passes, f.measured, f.beyond_4) == (4, 3, 1)
    assert f.mean_mps == pytest.approx(0.1)
    assert f.max_mps == pytest.approx(0.5)
    assert f.std_mps == pytest.approx(math.sqrt((0 + 0.16 + 0.16) / 3))
    assert f.sigma_ratio == pytest.approx(math.sqrt((1 + 9 + 25) / 3))
    assert math.isnan(pass_error(rejected))
    assert math.isnan(sigma_share(rejected))


def test_exact_sigmas_have_a_ratio_of_one():
    rng = np.random.default_rng(0)
    sigmas = rng.uniform(0.05, 0.5, 400)
    f = pass_figures([measured(float(s * rng.standard_normal()), float(s)) for s in sigmas])
    # the mean of 400 squared standard normals has a deviation of sqrt(2 / 400)
    assert abs(f.sigma_ratio ** 2 - 1) < 4 * math.sqrt(2 / 400)


def test_statistics_equal_numpy_and_are_nan_for_no_values():
    nothing, some = np.zeros(0), np.array([3.0, -4.0, 1.0])
    assert all(math.isnan(f(nothing)) for f in (mean, std, rms, greatest))
    assert (mean(some), greatest(some)) == (0.0, 4.0)
    assert rms(some) ** 2 == pytest.approx(mean(some) ** 2 + std(some) ** 2) == 26 / 3
    assert finite(np.array([np.nan, 1.0, np.inf])).tolist() == [1.0]


def test_mean_and_deviation_are_in_mph():
    assert mean_and_std(-0.0447, 0.44704) == '-0.100 ± 1.000'
    assert mean_and_std(math.nan, math.nan) == '-'
