# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What is said of a whole pass: further doubt, rejection, the ends of its profile."""
from __future__ import annotations

from dataclasses import replace

import pytest
from stereo_speed.core.passes import PassResult, Reason, SpeedBudget, Verdict

PASS = PassResult(
    track=0, lane='a', first_ns=0, last_ns=20, pairs=3, speed_mps=20.0, speed_std_mps=0.05,
    verdict=Verdict.MEASURED, reason='', smoothed={20: 18.0, 0: 22.0, 10: 20.0},
    smoothed_std={20: 0.3, 0: 0.4, 10: 0.0},
    budget=SpeedBudget(matching_mps=0.03, path_mps=0.0, stamps_mps=0.04, calibration_mps=0.0))


def test_doubt_is_independent_and_goes_into_its_part():
    # 0.2 % of 20 m/s is 0.04 m/s
    doubted = PASS.doubted(0.002, 'calibration_mps')
    assert doubted.speed_std_mps == pytest.approx((0.05 ** 2 + 0.04 ** 2) ** 0.5)
    assert doubted.budget.total_mps == pytest.approx(doubted.speed_std_mps)
    assert doubted.budget == replace(PASS.budget, calibration_mps=pytest.approx(0.04))
    assert doubted.smoothed_std[10] == pytest.approx(0.04)
    assert doubted.smoothed_std[0] == pytest.approx((0.4 ** 2 + 0.044 ** 2) ** 0.5)
    twice = doubted.doubted(0.002, 'calibration_mps')
    assert twice.budget.calibration_mps == pytest.approx(0.04 * 2 ** 0.5)


def test_a_pass_without_a_speed_has_no_doubt():
    rejected = PASS.rejected(Reason.UNCERTAIN)
    assert rejected.doubted(0.1, 'stamps_mps') is rejected
    assert (rejected.speed_mps, rejected.speed_std_mps, rejected.budget) == (None, None, None)
    assert not rejected.smoothed and rejected.profile_mps == (None, None, None)


def test_the_profile_is_told_by_its_ends_and_its_greatest_speed():
    assert PASS.profile_mps == (22.0, 18.0, 22.0)
