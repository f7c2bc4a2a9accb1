# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Two-wheelers: fronts that are narrow, and alone on the road."""
from __future__ import annotations

from drawn_fronts import Front, LANES, pair_of, RIG, SPEED_MPS, STEP_NS
import pytest
from stereo_speed.detection.config import DetectorConfig, FrontConfig
from stereo_speed.detection.detector import PlaneSweepDetector

STEP_M = SPEED_MPS * STEP_NS * 1e-9


def test_a_narrow_front_is_found_in_the_second_pair():
    detector = PlaneSweepDetector(RIG, LANES, DetectorConfig())
    found = [detector.update(pair_of([Front(20.0 + k * STEP_M, half_m=0.4)], k))
             for k in range(2)]
    assert not found[0]
    (one,) = found[1]
    assert one.width_m < 1.2
    assert one.s_m == pytest.approx(20.0 + STEP_M, abs=0.5)
    assert one.speed_mps == pytest.approx(SPEED_MPS, rel=0.05)


@pytest.mark.parametrize('limits', [
    {'narrow_least_m': 1.0}, {'narrow_low_m': 0.8}, {'narrow_high_m': 0.7}])
def test_what_a_narrow_front_is_can_be_set(limits):
    def seen(front):
        detector = PlaneSweepDetector(RIG, LANES, DetectorConfig(front=front))
        return [(one.s_m, one.width_m, one.left_px.tolist()) for k in range(2)
                for one in detector.update(pair_of(
                    [Front(20.0 + k * STEP_M, half_m=0.25)], k))]
    assert seen(FrontConfig(**limits)) != seen(FrontConfig())


def test_what_stands_still_is_no_two_wheeler():
    detector = PlaneSweepDetector(RIG, LANES, DetectorConfig())
    assert not any(detector.update(pair_of([Front(20.0, half_m=0.4)], k)) for k in range(3))


def test_part_of_a_wide_front_is_no_two_wheeler():
    detector = PlaneSweepDetector(RIG, LANES, DetectorConfig())
    wide = [Front(20.0 + k * STEP_M, symmetric=False) for k in range(3)]
    assert not any(detector.update(pair_of([front], k)) for k, front in enumerate(wide))
