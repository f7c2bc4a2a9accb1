# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Lane markings and kerbs in drawn views, at exactly known positions."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from stereo_speed.site.refine.config import RefineConfig
from stereo_speed.site.refine.markings import locate, locate_both

WIDTH_M, ASPHALT = 0.15, 80.0


def ends(road, name, right):
    """Return the first and last clicked points of a line."""
    return road.lines[name].views_px[right][[0, -1]]


@pytest.mark.parametrize('name, right', [('right', 0), ('left', 1)])
def test_bands_are_found_to_hundredths_of_a_pixel(drawn_off, name, right):
    """From a prior road that is wrong by some px, and with a consistent 1-sigma."""
    road, noise = drawn_off, 2.0
    view = road.view(name, right, road.image(right, noise=noise), noise)
    found = locate(view, ends(road, name, right))
    off = road.off_px(name, found.uv_px, right)
    assert found.shape.kind == 'band' and found.shape.width_m == pytest.approx(WIDTH_M, abs=0.01)
    assert np.sqrt(np.mean(off**2)) < 0.03
    assert np.sum((off / found.std_px)**2) < chi2.ppf(0.999, len(off))
    assert found.used > 0.8 * found.sections and len(off) > 15
    again = locate(view, ends(road, name, right), found.shape)
    assert again.shape.width_m == pytest.approx(WIDTH_M, abs=0.01)


def test_only_the_floor_remains_without_noise(drawn):
    config = RefineConfig(floor_std_px=0.05)
    found = locate(drawn.view('right', 0, drawn.image(0)), ends(drawn, 'right', 0), config=config)
    assert np.abs(drawn.off_px('right', found.uv_px, 0)).max() < 0.01
    np.testing.assert_allclose(found.std_px, 0.05, rtol=0.05)
    some = np.arange(len(found.s_m)) < 4
    np.testing.assert_array_equal(found.take(some).uv_px, found.uv_px[:4])
    assert found.take(some).shape is found.shape


def test_kerbs_are_edges(drawn_off):
    found = locate(drawn_off.view('left', 0, drawn_off.image(0, width_m=0.0, noise=1.0)),
                   ends(drawn_off, 'left', 0))
    assert found.shape.kind == 'edge' and found.shape.width_m == 0
    assert np.abs(drawn_off.off_px('left', found.uv_px, 0)).max() < 0.15


def test_gaps_and_poles_are_left_out(drawn):
    """Less of a dashed line than its dashes is used; a dark pole in front does not bend it."""
    image = drawn.image(0, period_m=8.0, noise=1.0)
    image[:200, 255:262] = 20.0
    found = locate(drawn.view('right', 0, image), ends(drawn, 'right', 0))
    assert 0.15 < found.used / found.sections < 0.65
    off = drawn.off_px('right', found.uv_px, 0)
    assert np.sqrt(np.mean(off**2)) < 0.05


@pytest.mark.parametrize('kind, sign', [('band', 1), ('band', -1), ('edge', 1)])
def test_only_light_bands_count_where_lamps_sweep(drawn, kind, sign):
    """There an edge may be that of their light, and what is dark may be a gap in it."""
    image = drawn.image(0, noise=1.0, **({} if kind == 'band' else {'width_m': 0.0}))
    view = drawn.view('right', 0, ASPHALT + sign * (image - ASPHALT))
    change = np.zeros((180, 320), np.float32)
    change[125:] = 0.3
    view = replace(view, view=replace(view.view, change=change))
    both = [locate(view, ends(drawn, 'right', 0), config=RefineConfig(steady_share=share))
            for share in (0.31, 0.29)]
    for found in both:
        assert (found.shape.kind, found.shape.sign) == (kind, sign)
        assert np.abs(drawn.off_px('right', found.uv_px, 0)).max() < 0.2
        again = locate(view, ends(drawn, 'right', 0), found.shape, RefineConfig(steady_share=0.29))
        assert again.sections == both[1].sections
    steady, swept = (found.uv_px[:, 1].max() for found in both)
    assert steady > 270 and (swept > 270 if (kind, sign) == ('band', 1) else swept < 252)


def test_streak_of_light_beside_a_kerb_is_no_line(drawn):
    """In steady light the kerb is found; swept by lamps it is not, nor what is light beside it."""
    kerb, band = (drawn.image(0, noise=1.0, width_m=width_m) for width_m in (0.0, WIDTH_M))
    view = drawn.view('right', 0, kerb + 0.15 * np.roll(band - ASPHALT, 6, axis=1))
    assert locate(view, ends(drawn, 'right', 0)).shape.kind == 'edge'
    swept = replace(view, view=replace(view.view, change=np.full((180, 320), 0.3, np.float32)))
    assert locate(swept, ends(drawn, 'right', 0)) is None


@pytest.mark.parametrize('unlit_rows', [0, 66, 110])
def test_line_that_lamps_light_is_found_beside_dark_places(drawn, unlit_rows):
    """Its far end is as good as black, at 2 grey levels, in steady light."""
    image = 0.5 * drawn.image(0, noise=1.0)
    change = np.full((180, 320), 0.3, np.float32)
    image[:unlit_rows], change[:unlit_rows // 2] = 2.0, 0.0
    view = drawn.view('right', 0, image, 0.5)
    found = locate(replace(view, view=replace(view.view, change=change)),
                   ends(drawn, 'right', 0))
    assert np.abs(drawn.off_px('right', found.uv_px, 0)).max() < 0.2 and len(found.uv_px) > 10


@pytest.mark.parametrize('noise', [0.0, 3.0])
def test_bare_road_has_no_line(drawn, noise):
    bare = ASPHALT + noise * np.random.default_rng(0).standard_normal((360, 640))
    assert locate(drawn.view('right', 0, bare, max(noise, 1.0)), ends(drawn, 'right', 0)) is None


def test_search_range_is_a_parameter(draw):
    """A road known to 40 cm is 8 to 30 px off: a search of 35 px finds its line, of 3 px not."""
    road = draw(0.4)
    view = road.view('right', 0, road.image(0))
    found = locate(view, ends(road, 'right', 0), config=RefineConfig(search_px=35.0))
    assert np.abs(road.off_px('right', found.uv_px, 0)).max() < 0.02 and len(found.uv_px) > 15
    assert locate(view, ends(road, 'right', 0), config=RefineConfig(search_px=3.0)) is None


def test_too_short_line_is_not_found(drawn):
    a = ends(drawn, 'right', 0)[0]
    assert locate(drawn.view('right', 0, drawn.image(0)), np.stack([a, a + 3.0])) is None


def test_line_in_a_shadows_edge_is_of_one_kind_in_both_views(drawn_off):
    """Alone, the slightly paler paint of the right view would lose against the edge."""
    road, views = drawn_off, []
    for right, paint in enumerate((0.55, 0.42)):
        band, edge = (road.image(right, **how) - ASPHALT for how in (
            {'noise': 1.0, 'seed': right}, {'width_m': 0.0}))
        edge[:62] = 0.0  # the sky
        views.append(road.view('right', right, ASPHALT + paint * band + 2 * edge))
    clicked = [ends(road, 'right', right) for right in (0, 1)]
    alone = [locate(view, uv) for view, uv in zip(views, clicked)]
    both = locate_both(views, clicked)
    assert [line.shape.kind for line in alone] == ['band', 'edge']
    apart, together = (
        np.diff([np.median(road.off_px('right', line.uv_px, right))
                 for right, line in enumerate(lines)])[0] for lines in (alone, both))
    assert both[0].shape.kind == both[1].shape.kind and len(both[0].s_m) > 10
    assert abs(together) < 0.15 < 1.0 < abs(apart)
    again = locate_both(views, clicked, both)
    assert [line.shape.kind for line in again] == [line.shape.kind for line in both]


def test_line_that_only_one_view_shows_is_not_found(drawn):
    clicked = [ends(drawn, 'right', right) for right in (0, 1)]
    bare = np.full((360, 640), ASPHALT)
    seen = drawn.view('right', 0, drawn.image(0))
    assert locate_both([seen, drawn.view('right', 1, bare)], clicked) is None
    assert locate_both([seen, drawn.view('right', 1, drawn.image(1))], clicked) is not None
