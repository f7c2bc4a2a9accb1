# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The background: worked by hand, occlusion by a target, and learning afterwards."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from stereo_speed.monocular.background_model import BackgroundModel
from stereo_speed.monocular.colour_bins import BinImage, Boxes, grid_points

WIDTH, HEIGHT = 40, 24


def flat(level, block=None, colour=200):
    image = np.full((HEIGHT, WIDTH, 3), level, np.uint8)
    if block is not None:
        x, y, w, h = block
        image[y:y + h, x:x + w, 1] = colour  # one channel is sufficient
    return image


def whole(background, image):
    return background.foreground(image, 0, 0, WIDTH, HEIGHT)


def target(*box):
    return SimpleNamespace(envelope_px=np.array(box, dtype=float))


def test_nothing_is_background_before_it_was_seen():
    assert whole(BackgroundModel(WIDTH, HEIGHT, 25, 100), flat(90)).all()


@pytest.mark.parametrize('off, seen', [(20, False), (30, True)])
def test_significant_contrast(off, seen):
    """A block of 12 by 8 px in one channel; the median rounds off one cell at each corner."""
    background = BackgroundModel(WIDTH, HEIGHT, 25, 100)
    background.learn(flat(90), [])
    found = whole(background, flat(90, (10, 8, 12, 8), 90 + off))
    wanted = np.zeros((HEIGHT, WIDTH), dtype=bool)
    wanted[8:16, 10:22] = seen
    for y in (8, 14):
        for x in (10, 20):
            wanted[y:y + 2, x:x + 2] = False
    np.testing.assert_array_equal(found, wanted)


def test_rectangle_is_part_of_the_whole():
    rng = np.random.default_rng(3)
    background = BackgroundModel(WIDTH + 1, HEIGHT + 1, 25, 100)  # odd sizes
    images = rng.integers(0, 50, (2, HEIGHT + 1, WIDTH + 1, 3), dtype=np.uint8)
    background.learn(images[0], [])
    all_of_it = background.foreground(images[1], 0, 0, WIDTH + 1, HEIGHT + 1)
    for left, top, right, bottom in ((3, 5, 22, 17), (8, 6, 9, 7), (30, 11, 41, 25)):
        np.testing.assert_array_equal(background.foreground(images[1], left, top, right, bottom),
                                      all_of_it[top:bottom, left:right])
    assert 0.1 < all_of_it.mean() < 0.9


def test_area_hidden_by_a_target_is_learnt_when_it_has_left():
    box = (10, 8, 12, 8)
    background = BackgroundModel(WIDTH, HEIGHT, 25, 100)
    background.learn(flat(90, box), [target(*box)])
    assert whole(background, flat(90))[8:16, 10:22].all()  # unknown, so it may be the target's
    assert not whole(background, flat(90))[:4].any()
    for _ in range(4):  # every fourth row in a frame
        background.learn(flat(90), [])
    assert not whole(background, flat(90)).any()
    assert whole(background, flat(90, box))[10:14, 12:20].all()


def test_mean_of_a_row_over_its_updates():
    """Rows 0, 4, ... of the cells are learnt in frames 2, 6, ...: levels 60 and 90 after 30."""
    background = BackgroundModel(WIDTH, HEIGHT, 25, 1e5)
    background.learn(flat(30), [])
    for level in (60, 0, 0, 0, 90):
        background.learn(flat(level), [])
    np.testing.assert_allclose(background.mean[0], 60, atol=1e-3)
    np.testing.assert_allclose(background.mean[1], 15, atol=1e-3)


def test_background_has_a_colour_of_its_own():
    background = BackgroundModel(WIDTH, HEIGHT, 25, 100)
    background.learn(flat(90), [])
    boxes = Boxes(np.array([[15.5, 11.5]]), np.array([[20.0, 16.0]]), None)
    grid = grid_points(10, 8)
    image = flat(90, (10, 8, 12, 8))
    bins, plain = (BinImage(image, b).sample(boxes, grid)[0][0] for b in (background, None))
    # 90 is in the bin 5 of its channel, 200 in 12
    assert set(plain.tolist()) == {0x555, 0x5c5} and set(bins.tolist()) == {4096, 0x5c5}
    assert np.mean(bins == 4096) > np.mean(plain == 0x555)  # corners are rounded


@pytest.mark.parametrize('box, but, wanted', [
    ((0, 0, 8, 8), (30, 10, 4, 4), 1.0), ((16, 0, 8, 8), (30, 10, 4, 4), 0.5),
    ((20, 0, 8, 8), (30, 10, 4, 4), 0.0), ((0, 0, 8, 8), (0, 0, 7, 3), 0.5),
    ((0, 0, 8, 8), (-9, -9, 60, 60), 0.0), ((50, 0, 8, 8), (0, 0, 8, 8), 1.0)])
def test_known_share_of_a_box(box, but, wanted):
    """Seen twice up to column 19: a target stood from 22 on, with its margin of a tenth."""
    background = BackgroundModel(WIDTH, HEIGHT, 25, 100)
    for _ in range(5):
        background.learn(flat(90), [target(22, -10, 20, 60)])
    share = background.known_share(np.array(box, dtype=float), np.array(but, dtype=float), 2)
    assert share == pytest.approx(wanted)
