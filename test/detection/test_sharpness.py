# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Fronts in views of unequal sharpness, of which little is visible, or of several kinds."""
from __future__ import annotations

from dataclasses import replace

import cv2
from drawn_fronts import Front, LANES, pair_of, RIG, SPEED_MPS, STEP_NS
import numpy as np
import pytest
from stereo_speed.detection.config import DetectorConfig, FrontConfig
from stereo_speed.detection.detector import PlaneSweepDetector

STEP_M = SPEED_MPS * STEP_NS * 1e-9


def out_of_focus(pair, side, blur_px, rng):
    """Return a pair with one view blurred, before the sensor noise is added."""
    view = cv2.GaussianBlur(getattr(pair, side), (0, 0), blur_px).astype(float)
    noisy = np.clip(np.round(view + rng.normal(0, 1.0, view.shape)), 0, 255).astype(np.uint8)
    return replace(pair, **{side: noisy})


def found_in(fronts, change=lambda pair: pair, config=DetectorConfig()):
    """Return the detections in each pair, given a list of fronts for each."""
    detector = PlaneSweepDetector(RIG, LANES, config)
    return [detector.update(change(pair_of(one, k))) for k, one in enumerate(fronts)]


@pytest.mark.parametrize('side', ['left', 'right'])
@pytest.mark.parametrize('blur_px', [0.8, 1.5])
def test_front_is_found_with_one_view_out_of_focus(side, blur_px):
    rng = np.random.default_rng(5)
    found = found_in([[Front(20.0 + k * STEP_M)] for k in range(2)],
                     lambda pair: out_of_focus(pair, side, blur_px, rng))
    (one,) = found[1]
    assert one.s_m == pytest.approx(20.0 + STEP_M, abs=1.0)


@pytest.mark.parametrize('side, more_px2', [('left', -9.0), ('right', 9.0)])
def test_known_difference_of_focus_no_longer_hides_a_front(side, more_px2):
    def found(told):
        rng = np.random.default_rng(5)
        return found_in(
            [[Front(20.0 + k * STEP_M)] for k in range(2)],
            lambda pair: replace(out_of_focus(pair, side, 3.0, rng), blur_px2=told))[1]
    assert not found(0.0)
    (one,) = found(more_px2)
    assert one.s_m == pytest.approx(20.0 + STEP_M, abs=0.3)


@pytest.mark.parametrize('side', ['left', 'right'])
def test_flat_marking_is_no_front_out_of_focus_either(side):
    rng = np.random.default_rng(6)
    found = found_in([[Front(20.0 + k * STEP_M, lying=True)] for k in range(3)],
                     lambda pair: out_of_focus(pair, side, 2.0, rng))
    assert not any(found)


def test_front_visible_only_high_up_is_found():
    """At night only the lamps of a van are visible, above the usual height of cars' fronts."""
    fronts = [[Front(20.0 + k * STEP_M, low_m=0.85)] for k in range(2)]
    assert len(found_in(fronts)[1]) == 1
    low = FrontConfig(raised_low_m=0.2, raised_high_m=0.6, narrow_most_m=0.6)
    assert not found_in(fronts, config=DetectorConfig(front=low))[1]


@pytest.mark.slow
def test_front_partly_visible_low_down_is_located_higher_up():
    """A lorry's bumper at night is dark except for its middle; near a tie in most positions."""
    def lorry(s_m):
        return [Front(s_m, half_m=0.7), Front(s_m, half_m=1.2, low_m=0.65)]
    places = (18.0, 19.6, 21.2, 22.8, 24.4)
    fronts = [found_in([lorry(at_m + k * STEP_M) for k in range(2)])[1] for at_m in places]
    high = [one for (one,) in fronts if one.height_m == pytest.approx(0.85)]
    assert len(high) > len(places) / 2
    assert min(one.width_m for one in high) > 2.0  # its outermost strong edges


def test_object_beside_a_front_does_not_move_its_place_up():
    """A wall that it passes is visible beside the front, but does not move with it."""
    def before_wall(k):
        return [Front(20.0 + STEP_M, half_m=1.2, low_m=0.65), Front(20.0 + k * STEP_M, half_m=0.7)]
    (one,) = found_in([before_wall(k) for k in range(2)])[1]
    assert one.height_m == pytest.approx(0.51) and one.width_m < 1.6


@pytest.mark.parametrize('half_m', [0.9, 1.2])
def test_front_whose_width_shows_low_down_is_located_there(half_m):
    (one,) = found_in([[Front(20.0 + k * STEP_M, half_m=half_m)] for k in range(2)])[1]
    assert (one.width_m, one.height_m) == (pytest.approx(2 * half_m, abs=0.2),
                                           pytest.approx(0.51))
