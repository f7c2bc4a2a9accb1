# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Markings that cannot be the clicked ones."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stereo_speed.core.records import StereoPair
from stereo_speed.site.file import PickedLine
from stereo_speed.site.refine.clicked import (
    ClickDistance, Clicks, Feet, not_clicked, scatter_px)
from stereo_speed.site.refine.refiner import refine_site

ON = ClickDistance(0.2, -2.0)


@pytest.mark.parametrize('lines, wrong', [
    ({'a': ON, 'b': ON, 'c': ClickDistance(4.0, 1.8)}, {'c'}),
    ({'a': ON, 'b': ON, 'c': ClickDistance(4.0, 1.0)}, set()),  # 3 sigmas are 1.08 px
    ({'a': ON, 'c': ClickDistance(4.0, 1.8)}, {'c'}),
    ({'a': ClickDistance(3.0, 1.8), 'b': ClickDistance(3.0, 1.0),
      'c': ClickDistance(3.0, 2.0)}, set()),  # a knock
    ({'a': ClickDistance(9.0, 8.0), 'b': ON, 'c': ClickDistance(4.0, 1.8), 'd': ON}, {'a', 'c'}),
    ({'n': ClickDistance(np.nan, np.nan), 'a': ON, 'b': ON, 'c': ClickDistance(4.0, 1.8)}, {'c'}),
    ({'a': ClickDistance(1.0, 0.91)}, {'a'}), ({'a': ClickDistance(1.0, 0.89)}, set()),
    ({}, set())])
def test_lines_are_too_far_off_where_others_lie_on_their_clicks(lines, wrong):
    """With clicks of 0.3 px, three sigmas of these and of what clicks do beside other lines."""
    assert not_clicked(lines, 0.3, 3.0) == wrong


@pytest.mark.parametrize('right', (0, 1))
def test_distances_equal_those_of_the_drawing(drawn, right):
    """Pixels 0.1 m beside a level line 3 m below are off by f 0.1 / z times the slope's cosine."""
    z = np.linspace(40.0, 14.0, 9)
    points = np.column_stack([np.full(9, -2.0 + 0.1), np.full(9, 3.0), z])
    feet = Feet.of(drawn.fit, 'right', bool(right), drawn.rig.project(points)[right])
    off_px, px_per_m = feet.off_px, feet.px_per_m
    x = -2.0 - 0.5 * right  # from this camera
    cosine = 3.0 / np.hypot(3.0, x)  # the line's image goes through the vanishing point
    np.testing.assert_allclose(np.abs(off_px), 90.0 / z * cosine, rtol=1e-3)
    np.testing.assert_allclose(px_per_m, 900.0 / z * cosine, rtol=0.02)  # at the foot, not beside
    clicks, on = ([drawn.rig.project(at)[r] for r in (0, 1)]
                  for at in (points, points - [0.1, 0.0, 0.0]))
    both = ClickDistance.of(drawn.fit, 'right', 0.12, clicks, on)
    assert both.outside_px == pytest.approx(0.4 * both.off_px, rel=0.05)  # 0.1 - 0.06 m
    assert ClickDistance.of(drawn.fit, 'right', 0.0, clicks, on).outside_px < 0  # in a kerb stone


def test_distance_is_that_from_the_marking_where_the_road_is_off_it(drawn):
    """A shadow taken for one of the lines pulls the road off the others."""
    z = np.linspace(40.0, 14.0, 9)
    clicks, found = ([drawn.rig.project(np.column_stack([
        -2.0 + x_m, np.full(9, 3.0), z]))[r] for r in (0, 1)] for x_m in (
            np.linspace(0.5, 0.2, 9), np.linspace(0.6, 0.2, 9)))
    cosine = 3.0 / np.hypot(3.0, 1.8)
    apart_px = np.median(900.0 / z * np.linspace(0.1, 0.0, 9)) * cosine
    off_px = ClickDistance.of(drawn.fit, 'right', 0.12, clicks, found).off_px
    assert off_px == pytest.approx(apart_px, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize('off_m, lost', [
    ({'left': 0.13}, ('left',)),  # another band: the light beside a rail's shadow
    ({'left': 0.07}, ()),  # its edge was clicked
    ({'left': 0.13, 'right': 0.13}, ())])  # the rig was displaced since
def test_band_beside_the_clicks_of_a_line_is_not_taken_for_it(drawn, off_m, lost):
    rng, z = np.random.default_rng(3), np.linspace(44.0, 13.0, 14)
    lines = {name: PickedLine(name, *(
        drawn.rig.project(np.column_stack([np.full(14, x + off_m.get(name, 0.0)),
                                           np.full(14, 3.0), z]))[right]
        + rng.normal(0, 0.3, (14, 2)) for right in (0, 1)))
        for name, x in (('right', -2.0), ('left', 1.5))}
    images = [np.rint(drawn.image(right, noise=1.0, seed=right)).astype(np.uint8)
              for right in (0, 1)]
    site = replace(drawn.site, lines=lines)
    assert refine_site(site, drawn.rig, [StereoPair(0, 0, 0, *images)]).lost == lost


def _beside(drawn, beside_m):
    """Return pixels of both views, so far beside both lines that run to a depth of 40 m."""
    return {name: Clicks(0.12, drawn.rig.project(points)[:2])
            for name, points in _places_m(beside_m).items()}


def _places_m(beside_m=0.0):
    z = np.linspace(40.0, 14.0, 9)
    return {name: np.column_stack([np.full(9, x_m + beside_m), np.full(9, 3.0), z])
            for name, x_m in (('right', -2.0), ('left', 1.5))}


def _off_px(drawn, lines):
    return np.concatenate([Feet.of(drawn.fit, name, bool(right), uv).off_px
                           for name, line in lines.items()
                           for right, uv in enumerate(line.views_px)])


@pytest.mark.parametrize('beside_m, share', [
    (0.05, (0.0, 0.02)),  # within the marking's half width of 0.06 m
    (0.4, (0.3, 0.7))])  # 0.06 m and the rotations that are allowed for leave about half
def test_what_clicks_have_in_common_is_no_scatter_within_a_marking(drawn, beside_m, share):
    lines = _beside(drawn, beside_m)
    off_px, scatter = _off_px(drawn, lines), scatter_px(drawn.fit, lines)
    assert share[0] <= np.linalg.norm(scatter) / np.linalg.norm(off_px) < share[1]
    bent = {name: line._replace(views_px=[
        uv + 0.3 * np.cos(np.arange(9.0) * np.pi)[:, None] for uv in line.views_px])
        for name, line in lines.items()}
    assert np.abs(scatter_px(drawn.fit, bent) - scatter).max() > 0.2


@pytest.mark.parametrize('axis, too_far_deg', [(0, 0.5), (1, 0.5), (2, 3.0)])
def test_a_rig_that_swayed_while_its_lines_were_clicked_is_no_scatter(drawn, axis, too_far_deg):
    """Clicks of a rig tilted by 0.1 degrees lie 1.6 px off."""
    for deg, most_px in ((0.1, 0.05), (too_far_deg, np.inf)):
        turn = Rotation.from_rotvec(np.radians(deg) * np.eye(3)[axis])
        clicks = {name: Clicks(0.12, drawn.rig.project(turn.apply(points))[:2])
                  for name, points in _places_m().items()}
        scatter = scatter_px(drawn.fit, clicks)
        assert np.abs(scatter).max() < most_px
    assert np.abs(scatter).max() > 0.2
