# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Results of passes: further doubt, rejection, the ends of the profile."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.passes import (
    PassResult, Reason, SpeedBudget, time_shares, Verdict)

PASS = PassResult(
    track=0, lane='a', first_ns=0, last_ns=20, pairs=3, speed_mps=20.0, speed_std_mps=0.05,
    verdict=Verdict.MEASURED, reason='', smoothed={20: 18.0, 0: 22.0, 10: 20.0},
    smoothed_std={20: 0.3, 0: 0.4, 10: 0.0},
    budget=SpeedBudget(matching_mps=0.03, path_mps=0.0, stamps_mps=0.04, calibration_mps=0.0))


def test_additional_doubt_is_independent_and_in_its_part_of_the_budget():
    # 0.2 % of 20 m/s is 0.04 m/s
    doubted = PASS.doubted(0.002, 'calibration_mps')
    assert doubted.speed_std_mps == pytest.approx((0.05 ** 2 + 0.04 ** 2) ** 0.5)
    assert doubted.budget.total_mps == pytest.approx(doubted.speed_std_mps)
    assert doubted.budget == replace(PASS.budget, calibration_mps=pytest.approx(0.04))
    assert doubted.smoothed_std[10] == pytest.approx(0.04)
    assert doubted.smoothed_std[0] == pytest.approx((0.4 ** 2 + 0.044 ** 2) ** 0.5)
    twice = doubted.doubted(0.002, 'calibration_mps')
    assert twice.budget.calibration_mps == pytest.approx(0.04 * 2 ** 0.5)


def test_pass_without_a_speed_has_no_doubt():
    rejected = PASS.rejected(Reason.UNCERTAIN)
    assert rejected.doubted(0.1, 'stamps_mps') is rejected
    assert (rejected.speed_mps, rejected.speed_std_mps, rejected.budget) == (None, None, None)
    assert not rejected.smoothed and rejected.profile_mps == (None, None, None)


def test_profile_is_summarised_by_its_ends_and_maximum():
    assert PASS.profile_mps == (22.0, 18.0, 22.0)


def test_pairs_represent_the_time_nearest_to_them():
    # By hand, in tenths of a second: from -1/2 to 1/2, 3/2, 3 and 9/2, of 5 in all.
    assert time_shares([0, 100, 200, 400]) == pytest.approx([0.2, 0.2, 0.3, 0.3])
    assert time_shares([7]) == pytest.approx([1.0])


@pytest.mark.parametrize('seed', range(5))
def test_mean_of_steady_braking_does_not_depend_on_missing_pairs(seed):
    rng = np.random.default_rng(seed)
    stamps = np.arange(40) * 66_666_667 + 1_700_000_000_000_000_000
    kept = stamps[np.r_[0, np.sort(rng.choice(np.arange(1, 39), 20, False)), 39]]
    speeds = 30 - 4e-9 * (kept - stamps[0])
    assert time_shares(kept) @ speeds == pytest.approx(30 - 4e-9 * 39 * 66_666_667 / 2, abs=1e-9)
