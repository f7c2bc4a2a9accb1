# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Annotated frames and drawings of maps: their content, and inputs that stay unmodified."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.monocular.boxes import TargetEstimate, TargetState
from stereo_speed.monocular.distance import DistanceField
from stereo_speed.report.overlay import colour_of
from stereo_speed.report.targets import draw_field, draw_targets


@pytest.fixture()
def labels():
    """Return a map: pathway to the left of column 40, inaccessible above row 10."""
    found = np.full((60, 80), 128, np.uint8)
    found[:, :40] = 255
    found[:10] = 0
    return found


def estimate(state=TargetState.TRACKED, angle_rad=0.0):
    return TargetEstimate(
        frame=1, id=3, state=state, box_px=np.array([30.0, 25, 20, 24]), angle_rad=angle_rad,
        distance_px=0.0, distance_rate_px=0.0, similarity=1.0, velocity_px=np.zeros(2))


def test_box_is_drawn_on_its_outline_in_the_colour_of_the_target():
    image = np.zeros((60, 80, 3), np.uint8)
    drawn = draw_targets(image, [estimate()])
    assert not image.any()  # the given frame is not modified
    for x, y in ((30, 37), (50, 37), (40, 49)):
        np.testing.assert_allclose(drawn[y, x], colour_of(3), rtol=0.2)  # smoothed
    assert not drawn[30:45, 35:45].any()


def test_rotated_box_is_drawn_rotated():
    drawn = draw_targets(np.zeros((60, 80, 3), np.uint8), [estimate(angle_rad=np.pi / 2)])
    np.testing.assert_allclose(drawn[37, 28], colour_of(3), rtol=0.2)  # 12 px from the centre
    assert not drawn[37, 31].any()


def test_predicted_box_has_a_thinner_outline():
    image = np.zeros((1200, 2048, 3), np.uint8)
    seen, predicted = (draw_targets(image, [estimate(state)]).any(axis=2)[37].sum()
                       for state in (TargetState.TRACKED, TargetState.OCCLUDED))
    assert seen > predicted > 0


def test_boundaries_of_the_map_are_drawn_on_the_frame(labels):
    drawn = draw_targets(np.zeros((60, 80, 3), np.uint8), [], labels).any(axis=2)
    wanted = np.zeros((60, 80), dtype=bool)
    wanted[10], wanted[10:, 40] = True, True
    np.testing.assert_array_equal(drawn, wanted)


def test_field_shows_kinds_and_contours_at_an_interval(labels):
    """Along row 50 the boundary is at 39.5; contours are 10 px apart on both sides of it."""
    drawn = draw_field(DistanceField(labels), step_px=10.0)
    assert len({tuple(drawn[y, x]) for y, x in ((50, 33), (50, 46), (4, 60))}) == 3
    plain = np.array([tuple(drawn[50, 33]), tuple(drawn[50, 46])])
    row = np.where(np.arange(80)[:, None] < 40, plain[0], plain[1])
    changed = np.flatnonzero(np.any(drawn[50] != row, axis=1))
    np.testing.assert_allclose(changed, [10, 20, 30, 40, 50, 60, 70], atol=1)


def test_field_over_an_image_does_not_modify_it(labels):
    image = np.full((60, 80, 3), 77, np.uint8)
    drawn = draw_field(DistanceField(labels), image)
    assert np.all(image == 77) and np.any(drawn != 77)
    np.testing.assert_array_equal(drawn[55, 70], image[55, 70])  # accessible ground has no tint
