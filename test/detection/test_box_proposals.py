# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Positions on a lane that a box may represent, and fronts that fit it."""
from __future__ import annotations

from drawn_fronts import LANE, RIG
import numpy as np
import pytest
from stereo_speed.detection.box_proposals import box_proposals, BoxFitConfig, fits_box
from stereo_speed.detection.lane_geometry import LaneGeometry
from stereo_speed.detection.protocol import ImageBox

FIT = BoxFitConfig()
BOX = ImageBox(left_px=100, top_px=100, width_px=100, height_px=100)


@pytest.fixture(scope='module')
def geometry():
    return LaneGeometry(RIG, LANE)


def box_at(geometry, s_m, x_m, half_m=0.9, height_m=1.5):
    """Return the box of a flat vehicle that stands on the road."""
    uv = geometry.project(np.array([s_m]), x_m + np.array([-half_m, half_m]),
                          np.array([height_m, 0.0]))[0].reshape(-1, 2)
    (left, top), (width, height) = uv.min(axis=0), np.ptp(uv, axis=0)
    return ImageBox(left_px=left, top_px=top, width_px=width, height_px=height)


@pytest.mark.parametrize('s_m', [15.0, 30.0, 45.0])
def test_first_place_is_where_the_box_meets_the_road(geometry, s_m):
    first = box_proposals(geometry, box_at(geometry, s_m, 0.4), 1.9, FIT)[0]
    assert first.s_m == pytest.approx(s_m, abs=0.01)
    assert first.x_m == pytest.approx(0.4, abs=0.01)
    assert first.half_m == pytest.approx(0.9, abs=0.01)


def test_further_places_cover_the_error_of_the_lower_edge(geometry):
    wide = BoxFitConfig(lower_edge_px=12.0)
    box = box_at(geometry, 25.0, 0.0)
    places = [p.s_m for p in box_proposals(geometry, box, 1.9, wide)]
    assert places[0] == pytest.approx(25.0, abs=0.01) and len(places) > 1
    step_m = 0.08 / abs(float(geometry.rates(np.array([25.0])).shift[0]))
    middle = np.array([box.left_px + box.width_px / 2, box.top_px + box.height_px])
    for off in (-12.0, 12.0):
        end = geometry.on_road(middle + [0.0, off])
        assert np.abs(np.array(places) - end).min() <= step_m
    assert len(box_proposals(geometry, box, 1.9, BoxFitConfig(lower_edge_px=0.0))) == 1


@pytest.mark.parametrize('x_m', [-6.0, 6.0])
def test_box_beside_the_lane_proposes_nothing(geometry, x_m):
    assert box_proposals(geometry, box_at(geometry, 30.0, x_m), 1.9, FIT) == []


def test_box_in_the_sky_proposes_nothing(geometry):
    sky = ImageBox(left_px=300, top_px=-900, width_px=50, height_px=50)
    assert box_proposals(geometry, sky, 1.9, FIT) == []


@pytest.mark.parametrize(('low', 'high', 'fit', 'fits'), [
    ((110, 150), (190, 190), FIT, True),
    ((90, 150), (190, 190), FIT, True),  # beside it by less than 15 px
    ((80, 150), (190, 190), FIT, False),
    ((110, 105), (190, 115), FIT, False),  # in its upper part: a windscreen
    ((110, 105), (190, 115), BoxFitConfig(lower_share=1.0), True),
    ((110, 150), (135, 190), FIT, False),  # a quarter of its width
    ((110, 150), (135, 190), BoxFitConfig(side_share=0.8), True),
    ((110, 170), (190, 214), FIT, True),
    ((110, 170), (190, 214), BoxFitConfig(margin_share=0.1), False),
])
def test_front_lies_in_the_lower_part_of_its_box(low, high, fit, fits):
    quad = np.array([low, (high[0], low[1]), high, (low[0], high[1])], float)
    assert fits_box(quad, BOX, fit) == fits
