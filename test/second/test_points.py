# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Corners of a textured board whose positions in both views are known exactly."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.core.records import StereoPair
from stereo_speed.core.tracker_config import SecondConfig
from stereo_speed.second.points import CornerFollower

SIZE = (240, 320)
DISPARITY_PX = 7.3


def board(scale: float, at: tuple[float, float], gain: float = 1.0, depth=np.uint8):
    """Return an image of a board scaled about (0, 0), then moved; everything else is grey."""
    rng = np.random.default_rng(3)
    texture = cv2.GaussianBlur(rng.normal(0, 1, (120, 160)).astype(np.float32), (0, 0), 1.5)
    texture = (125 + 40 * texture / texture.std()).astype(np.float32)
    how = np.array([[scale, 0, at[0]], [0, scale, at[1]]])
    image = cv2.warpAffine(texture, how, SIZE[::-1], flags=cv2.INTER_CUBIC,
                           borderMode=cv2.BORDER_CONSTANT, borderValue=125)
    noise = rng.normal(0, 1.0, SIZE)
    image = np.clip(gain * image + noise, 0, 255)
    return (16 * image).astype(depth) if depth is np.uint16 else image.round().astype(depth)


def pair(index: int, scale: float, at: tuple[float, float], **how) -> StereoPair:
    right = board(scale, (at[0] - DISPARITY_PX, at[1]), **{'gain': 0.9, **how})
    return StereoPair(index, index, index, board(scale, at, **how), right)


def region(scale: float, at: tuple[float, float]):
    return np.array([[0, 0], [80, 0], [80, 60], [0, 60.0]]) * scale + at


@pytest.mark.parametrize('depth', [np.uint8, np.uint16])
@pytest.mark.parametrize('off_px', [0.0, 3.0], ids=['as told', 'told badly'])
def test_corners_are_on_the_board(depth, off_px):
    follower = CornerFollower(SecondConfig())
    first = follower.take(pair(0, 1.0, (60.4, 50.2), depth=depth), region(1.0, (60.4, 50.2)),
                          region(1.0, (60.4 - DISPARITY_PX, 50.2)))
    told = region(1.15, (90.7 + off_px, 61.9 - off_px))
    second = follower.take(pair(1, 1.15, (90.7, 61.9), depth=depth), told,
                           told - [DISPARITY_PX - off_px, 0.0])
    assert len(first.ids) > 15
    for seen in (first, second):
        shift = seen.left_px - seen.right_px
        assert np.median(np.abs(shift - [DISPARITY_PX, 0.0])) < 0.1
    ids, a, b = np.intersect1d(first.ids, second.ids, return_indices=True)
    assert len(ids) > 10
    wanted = (first.left_px[a] - [60.4, 50.2]) * 1.15 + [90.7, 61.9]
    assert np.median(np.abs(second.left_px[b] - wanted)) < 0.15


def test_blank_region_gives_no_corners():
    follower, flat = CornerFollower(SecondConfig()), np.full(SIZE, 90, np.uint8)
    one = StereoPair(0, 0, 0, flat, flat)
    assert len(follower.take(one, region(1.0, (60, 50)), region(1.0, (50, 50))).ids) == 0
    wrong = [region(0.05, (60, 50)), region(np.nan, (60, 50))]
    for bad in wrong:
        assert follower.take(one, bad, region(1.0, (50, 50))) is None
        assert follower.take(one, region(1.0, (60, 50)), bad) is None


@pytest.mark.parametrize('runs_px', [(0.0, 0.0, 0.0), (3.0, -8.0, 0.0), (-2.0, 7.0, 2.0)],
                         ids=['as told', 'runs ahead', 'falls back, wrong range too'])
def test_diverging_region_does_not_carry_corners_along(runs_px):
    """A given region that leaves the board by most of its size moves no corner."""
    follower, first = CornerFollower(SecondConfig()), None
    for k in range(9):
        scale, at = 1.0 + 0.05 * k, (30.4 + 6 * k, 90.2 + 2.5 * k)
        told = region(scale, at) + k * np.array(runs_px[:2])
        seen = follower.take(pair(k, scale, at), told,
                             told - [DISPARITY_PX - k * runs_px[2], 0.0])
        first = seen if first is None else first
        shift = seen.left_px - seen.right_px
        assert np.median(np.abs(shift - [DISPARITY_PX, 0.0])) < 0.1
    ids, a, b = np.intersect1d(first.ids, seen.ids, return_indices=True)
    assert len(ids) > 5
    wanted = (first.left_px[a] - [30.4, 90.2]) * scale + at
    assert np.median(np.abs(seen.left_px[b] - wanted)) < 0.5
    on_board = (seen.left_px - at) / scale
    assert np.all((on_board > -4) & (on_board < [84, 64]))


def test_stationary_background_does_not_hold_a_region_back():
    """A third of the region shows a static wall; the moving board has more corners."""
    follower, rng = CornerFollower(SecondConfig()), np.random.default_rng(8)
    wall = np.repeat(np.repeat(rng.integers(60, 190, (60, 80)), 4, axis=0), 4, axis=1)
    for k in range(6):
        at, images = (60.4 + 3 * k, 80.2 + 4 * k), []
        for shift in (0.0, DISPARITY_PX):
            image = board(1.0, (at[0] - shift, at[1]))
            edge = round(at[1]) + 20
            image[:edge] = wall[:edge]
            images.append(image)
        seen = follower.take(StereoPair(k, k, k, *images), region(1.0, at),
                             region(1.0, at) - [DISPARITY_PX, 0.0])
    on_board = seen.left_px - at
    assert np.all((on_board > -4) & (on_board < [84, 64]))
