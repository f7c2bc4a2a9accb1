# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Known lengths: ends of dashes by hand, and a drawn road whose lengths are known."""
from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from stereo_speed.road.problem import RoadProblem
from stereo_speed.site.extras import DashPeriod, KnownLength, LinesApart, PointsApart
from stereo_speed.site.refine.config import RefineConfig
from stereo_speed.site.refine.known_lengths import (
    check_lengths, dash_ends, LengthCheck, spacing_of)


def test_ends_of_dashes():
    """Levels cross their middle halfway between samples; NaN and coarse steps are left out."""
    s = np.arange(0, 24, 0.25)
    grey = np.where(s % 8 < 4, 180.0, 80.0)
    np.testing.assert_allclose(dash_ends(s, grey, False, 8.0), [3.875, 11.875, 19.875])
    np.testing.assert_allclose(dash_ends(s, grey, True, 8.0), [7.875, 15.875])
    order = np.random.default_rng(0).permutation(len(s))
    np.testing.assert_allclose(dash_ends(s[order], grey[order], True, 8.0), [7.875, 15.875])
    grey[(s > 7) & (s < 9)] = np.nan  # a gap of 2 m in the visible part
    np.testing.assert_allclose(dash_ends(s, grey, True, 8.0), [15.875])
    assert dash_ends(s, np.full(len(s), np.nan), True, 8.0).size == 0
    assert dash_ends(np.zeros(0), np.zeros(0), True, 8.0).size == 0


def test_spacing_of_repeated_marks():
    """Also where some are missing; the 1-sigma is that of a straight line through them."""
    number = np.array([0, 1, 2, 4, 5, 7.0])
    rng, slopes = np.random.default_rng(1), []
    for _ in range(200):
        slope, std = spacing_of(3 + 9.02 * number + 0.05 * rng.standard_normal(6), 9.0)
        slopes.append((slope - 9.02) / std)
    # four degrees of freedom: Student's t has the variance 2
    assert np.var(slopes) == pytest.approx(2.0, rel=0.5)
    exact, std = spacing_of(9.0 * number, 9.0)
    assert exact == pytest.approx(9.0)
    assert std == pytest.approx(0.01 / np.sqrt(np.sum((number - number.mean())**2)))


@pytest.mark.parametrize('places', [[], [1.0, 10.0], [0.0, 1.0, 2.0, 3.0]])
def test_irregular_marks_have_no_spacing(places):
    assert math.isnan(spacing_of(np.array(places), 9.0)[0])


def test_length_is_wrong_beyond_what_chance_allows():
    near = LengthCheck('l', 3.0, 0.03, 3.14, 0.04, 3.0)
    assert near.off_sigmas == pytest.approx(2.8) and not near.wrong
    assert replace(near, most_sigmas=2.0).wrong and replace(near, measured_m=3.2).wrong
    assert not replace(near, measured_m=math.nan).wrong


@pytest.mark.slow
def test_lengths_of_a_drawn_road(drawn, drawn_refined):
    """Lines 3.5 m apart, dashes every 8 m, two points 5 m apart; and unmeasurable lengths."""
    points = np.array([[-2.0, 3, 20], [1, 3, 24]])
    known = (KnownLength('apart', 3.5, 0.01, LinesApart(('right', 'left'))),
             KnownLength('dashes', 8.0, 0.01, DashPeriod('right')),
             KnownLength('points', 5.0, 0.01, PointsApart(*drawn.rig.project(points)[:2], 0.2)),
             KnownLength('wrong', 8.3, 0.01, DashPeriod('left')))
    refined = replace(drawn_refined, site=replace(drawn.site, known_lengths=known))
    apart, dashes, pair, wrong = check_lengths(refined)
    assert apart.measured_m == pytest.approx(3.5) and not apart.wrong
    assert dashes.measured_m == pytest.approx(8.0, abs=0.03) and not dashes.wrong
    assert dashes.measured_std_m < 0.05
    assert pair.measured_m == pytest.approx(5.0, abs=1e-6) and pair.measured_std_m > 0.02
    assert wrong.wrong
    lenient = replace(refined, config=RefineConfig(length_sigmas=10.0))
    assert check_lengths(lenient)[3].wrong == (abs(wrong.off_sigmas) > 10)
    nothing = replace(refined, road=None, found={})
    assert [math.isnan(c.measured_m) for c in check_lengths(nothing)] == [True, True, False, True]
    problem = drawn_refined.road.problem
    behind = replace(problem.model, centre_m=problem.model.centre_m * [1, 1, -1])
    unseen = replace(refined, road=replace(drawn_refined.road, problem=RoadProblem(
        problem.rig, problem.picks, behind)))
    assert [math.isnan(c.measured_m) for c in check_lengths(unseen)] == [False, True, False, True]


def test_clicked_points_without_a_sigma_get_that_of_the_prior(drawn, drawn_refined):
    points = drawn.rig.project(np.array([[-2.0, 3, 20], [1, 3, 24]]))[:2]
    stds = []
    for std, prior_px in ((0.6, 0.3), (None, 0.6), (None, 0.3)):
        known = (KnownLength('points', 5.0, 0.01, PointsApart(*points, std)),)
        refined = replace(drawn_refined, site=replace(drawn.site, known_lengths=known),
                          prior=replace(drawn_refined.prior, pick_std_px=prior_px))
        stds.append(check_lengths(refined)[0].measured_std_m)
    assert stds[0] == stds[1] and stds[1] == pytest.approx(2 * stds[2], rel=0.01)
