# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Far points of markings too narrow to be told from what lies beside them."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.records import StereoPair
from stereo_speed.site.file import PickedLine
from stereo_speed.site.refine import refiner
from stereo_speed.site.refine.config import RefineConfig
from stereo_speed.site.refine.markings import LocatedLine
from stereo_speed.site.refine.refiner import refine_site
from stereo_speed.site.refine.section_model import BAND, EDGE, Shape
from stereo_speed.site.refine.unresolved import clicks_where_unresolved

Z_M = np.linspace(44.0, 13.0, 32)
WIDTH_M = 0.04  # 1 px at a depth of 36 m times the cosine of the line's slope in the image
CLICK_PX = 0.3
SIGMAS = 3.0


def width_px(x_m, right):
    """Return how wide a marking is at the depths of the points, px."""
    return WIDTH_M * 900.0 / Z_M * 3.0 / np.hypot(3.0, x_m - 0.5 * right)


def located(drawn, name, off_px, kind=BAND):
    """Return a line as found, so far to the left of its true place in each view."""
    shape = Shape(kind, WIDTH_M if kind == BAND else 0.0, 0.6, 1)
    return tuple(LocatedLine(drawn.line(name, Z_M, right) + np.stack(
        [off, np.zeros_like(off)], axis=-1), np.full(32, 0.05), Z_M[0] - Z_M, shape, 0.1, 90, 90)
        for right, off in enumerate(off_px))


def found_with(drawn, right=(0.0, 0.0), left=(0.0, 0.0), kind=BAND):
    """Return both lines as found, with errors (2,) or (2, n) of each, px."""
    return {name: located(drawn, name, [np.broadcast_to(np.asarray(o, float), 32) for o in off],
                          kind)
            for name, off in (('right', right), ('left', left))}


def thin(name, right):
    return width_px({'right': -2.0, 'left': 1.5}[name], right) < 1


@pytest.mark.parametrize('off_px, kind', [
    ({}, BAND),
    ({'right': (1.0, 1.0)}, BAND),  # 3 sigmas of clicks are 0.9 px across the line
    ({'right': (3.0, 3.0), 'left': (3.0, 3.0)}, BAND),  # a knock of the rig
    ({'right': [np.where(width_px(-2.0, 1) > 1.2, 3.0, 0.0)] * 2}, BAND),  # resolved
    ({'right': [np.where(width_px(-2.0, 0) < 1, 3.0, 0.0)] * 2}, EDGE)])
def test_points_stay(drawn, off_px, kind):
    found = found_with(drawn, **off_px, kind=kind)
    kept = clicks_where_unresolved(drawn.fit, drawn.lines, found, SIGMAS)
    assert kept.keys() == found.keys()
    assert all(kept[name] is found[name] for name in found)


def test_far_points_beside_the_clicks_give_way_to_these_in_both_views(drawn):
    """Though only those of one view contradict them; the other line stays."""
    far = np.where(thin('right', 0), 2.0, 0.0)
    found = found_with(drawn, right=(far, np.zeros(32)))
    kept = clicks_where_unresolved(drawn.fit, drawn.lines, found, SIGMAS)
    assert kept['left'] is found['left']
    for right, (line, before) in enumerate(zip(kept['right'], found['right'])):
        near = ~thin('right', right)
        clicks_px = drawn.lines['right'].views_px[right]
        # the clicks are at even depths, from 45 to 12 m
        scale = np.interp(np.linspace(-45, -12, 12), -Z_M, width_px(-2.0, right))
        wanted_px = np.concatenate([clicks_px[scale < 1], before.uv_px[near]])
        np.testing.assert_allclose(line.uv_px, wanted_px, atol=1e-9)
        assert (np.diff(line.s_m) > 0).all()
        count = int((scale < 1).sum())
        assert count >= 3
        np.testing.assert_allclose(line.std_px[:count], CLICK_PX, rtol=1e-3)
        np.testing.assert_array_equal(line.std_px[count:], 0.05)


def test_clicks_count_less_where_all_lines_are_off_theirs(drawn):
    """All resolved points lie 1 px beside the clicks, the far ones of one line 8 px."""
    far = np.where(thin('right', 0), 8.0, 1.0)
    kept = clicks_where_unresolved(drawn.fit, drawn.lines, found_with(
        drawn, right=(far, far), left=(1.0, 1.0)), SIGMAS)
    across_px = 3.0 / np.hypot(3.0, 2.0)  # of 1 px to the side; 0.86 to 0.89 for the other views
    assert kept['right'][0].std_px[0] == pytest.approx(np.hypot(CLICK_PX, across_px), rel=0.1)


def test_line_of_which_little_is_left_is_lost(drawn):
    far = np.where(thin('right', 0), 2.0, 0.0)
    found = found_with(drawn, right=(far, far))
    left, right = found['right']
    found['right'] = tuple(line.take(line.s_m < 10.0) for line in (left, right))
    few = PickedLine('right', *(uv[-2:] for uv in drawn.lines['right'].views_px))
    kept = clicks_where_unresolved(drawn.fit, {**drawn.lines, 'right': few}, found, SIGMAS)
    assert set(kept) == {'left'}


@pytest.mark.slow
def test_road_follows_the_clicks_there(drawn, monkeypatch):
    """Both lines are found farther and farther outside, as where the asphalt is lighter."""
    far = {name: np.where(Z_M > 28.0, 0.2 * sign * (Z_M - 28.0), 0.0)
           for name, sign in (('right', -1), ('left', 1))}
    found = found_with(drawn, **{name: (off, off) for name, off in far.items()})
    monkeypatch.setattr(refiner, 'locate_both', lambda views, *_: found[
        views[0].fit.names[views[0].line]])
    images = [np.clip(drawn.image(right, noise=1.0, seed=right), 0, 255).astype(np.uint8)
              for right in (0, 1)]
    pairs = [StereoPair(0, 0, 0, *images)]
    road = refine_site(drawn.site, drawn.rig, pairs, RefineConfig()).road
    far_m = road.points(0, road.feet.s_m.min(keepdims=True), np.zeros(1))
    assert abs(far_m[0, 1] - 3.0) < 0.03  # with the points as found, 0.36 m
