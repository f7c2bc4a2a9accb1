# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Annotated frames."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.records import TrackState
from stereo_speed.report.overlay import colour_of, draw, label, strip


def test_path_by_hand(pair, lanes, rig):
    """The path at x = 0, y = 2 m, z = 25 m is drawn at (320, 240 + 500 * 2 / 25)."""
    image = draw(pair, [], lanes, rig)
    assert image.shape == (480, 640, 3)
    assert image.dtype == np.uint8
    assert image[280, 320, 0] > image[280, 320, 2] + 40
    assert np.all(image[200:250] == 90)
    assert np.all(image[:, :300] == 90)


def test_front_is_drawn_at_its_place(pair, updates, lanes, rig):
    update = updates[4]
    image = draw(pair, [update], lanes, rig)
    top_left, _, bottom_right, _ = np.round(update.quad_left_px).astype(int)
    middle = (top_left[1] + bottom_right[1]) // 2
    for u in (top_left[0], bottom_right[0]):
        assert image[middle, u].astype(int).tolist() == pytest.approx(colour_of(3), abs=60)


def test_right_view_has_its_own_path_and_front(pair, updates, lanes, rig):
    image = draw(pair, updates[4:5], lanes, rig, right=True)
    left, right, _, _ = rig.project(np.array([[0.0, 2.0, 25.0]]))
    u, v = np.round(right[0]).astype(int)
    assert u != round(float(left[0, 0])) and image[v, u, 0] > image[v, u, 2] + 40
    top_left, _, bottom_right, _ = np.round(updates[4].quad_right_px).astype(int)
    middle = (top_left[1] + bottom_right[1]) // 2
    assert image[middle, top_left[0]].astype(int).tolist() == pytest.approx(colour_of(3), abs=60)


def test_input_is_not_modified(pair, updates, lanes, rig):
    draw(pair, updates[4:5], lanes, rig)
    assert np.all(pair.left == 90)


def test_sixteen_bits(pair, updates, lanes, rig):
    bright = replace(pair, left=np.full((480, 640), 40_000, np.uint16))
    image = draw(bright, [], {}, rig)
    assert image.dtype == np.uint8
    assert np.all(image == round(40_000 * 255 / 65_535))


@pytest.mark.parametrize('shift', [[-300.0, 0.0], [0.0, -250.0], [400.0, 300.0], [1e7, 1e7]],
                         ids=str)
def test_front_partly_or_wholly_outside(pair, updates, lanes, rig, shift):
    moved = replace(updates[4], quad_left_px=updates[4].quad_left_px + np.array(shift))
    assert draw(pair, [moved], lanes, rig).shape == (480, 640, 3)


def test_front_that_cannot_be_projected(pair, updates, rig):
    lost = replace(updates[4], quad_left_px=np.full((4, 2), np.nan))
    assert np.array_equal(draw(pair, [lost], {}, rig), draw(pair, [], {}, rig))


def test_label_by_hand(updates):
    """20 m/s is 44.74 mph and 72 km/h; 0.3 m/s is 0.67 mph and 1.08 km/h."""
    assert label(updates[4]) == ('#3 44.7 +/- 0.7 mph', '72.0 +/- 1.1 km/h')


def test_unconfirmed_track_shows_no_speed(updates):
    text = ' '.join(label(replace(updates[4], state=TrackState.TENTATIVE)))
    assert 'mph' not in text
    assert 'km/h' not in text


@pytest.mark.parametrize(('count', 'columns', 'shape'), [
    (1, 3, (30, 40)), (3, 3, (30, 128)), (4, 3, (64, 128)), (4, 2, (64, 84)),
], ids=str)
def test_strip_layout(count, columns, shape):
    frames = [np.full((60, 80, 3), 10 * k, np.uint8) for k in range(count)]
    sheet = strip(frames, columns=columns, width_px=40)
    assert sheet.shape == (*shape, 3)
    assert np.all(sheet[:30, :40] == 0)
    assert np.all(sheet[-30:, 44 * ((count - 1) % columns):][:, :40] == 10 * (count - 1))
