# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Boxes: overlap, corners and envelope against rasterised ones."""
from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_speed.monocular.boxes import (
    corners, envelope, overlap, Target, TargetEstimate, TargetState)


def drawn(box):
    """Draw a box of whole pixels."""
    mask = np.zeros((60, 60), dtype=bool)
    x, y, w, h = box
    mask[y:y + h, x:x + w] = True
    return mask


def test_overlap_equals_that_of_drawn_boxes():
    rng = np.random.default_rng(0)
    a = np.concatenate([rng.integers(0, 30, (200, 2)), rng.integers(1, 30, (200, 2))], axis=-1)
    b = np.concatenate([rng.integers(0, 30, (200, 2)), rng.integers(1, 30, (200, 2))], axis=-1)
    wanted = [np.sum(drawn(p) & drawn(q)) / np.sum(drawn(p) | drawn(q)) for p, q in zip(a, b)]
    found = overlap(a.astype(float), b.astype(float))
    np.testing.assert_allclose(found, wanted)
    assert np.sum(found == 0) > 10 and np.sum(found > 0.2) > 10
    np.testing.assert_array_equal(found, overlap(b.astype(float), a.astype(float)))
    assert overlap(a[:, None].astype(float), b[None, :7].astype(float)).shape == (200, 7)


def test_overlap_by_hand():
    box = np.array([10.0, 20.0, 4.0, 6.0])
    assert overlap(box, box) == 1
    assert overlap(box, box + [2, 0, 0, 0]) == pytest.approx(1 / 3)
    assert overlap(box, box + [4, 0, 0, 0]) == 0  # they touch
    assert overlap(box, np.array([11.0, 21.0, 2.0, 3.0])) == pytest.approx(6 / 24)  # inside
    assert overlap(np.zeros(4), np.zeros(4)) == 0


def test_corners_by_hand():
    box = np.array([10.0, 20.0, 8.0, 4.0])  # centre (14, 22)
    np.testing.assert_allclose(corners(box, 0.0), [[10, 20], [18, 20], [18, 24], [10, 24]])
    # a quarter turn from x towards y, y down: the upper left corner goes to the upper right
    np.testing.assert_allclose(corners(box, np.pi / 2), [[16, 18], [16, 26], [12, 26], [12, 18]],
                               atol=1e-12)


@pytest.mark.parametrize('angle_deg', [0, 17, 45, 90, 133, -60])
def test_envelope_and_corners_against_opencv(angle_deg):
    box = np.array([10.0, 20.0, 30.0, 8.0])
    points = cv2.boxPoints(((25.0, 24.0), (30.0, 8.0), float(angle_deg)))
    mine = corners(box, np.radians(angle_deg))
    gaps = np.linalg.norm(mine[:, None] - points[None], axis=-1)
    assert gaps.min(axis=1).max() < 1e-4 and len(set(gaps.argmin(axis=1))) == 4
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose(envelope(box, np.radians(angle_deg)),
                               np.concatenate([low, high - low]), atol=1e-4)


def test_envelope_by_hand():
    """A square on its tip is wider by the square root of two."""
    side = 10 * np.sqrt(2)
    np.testing.assert_allclose(envelope(np.array([0, 0, 10.0, 10.0]), np.pi / 4),
                               [5 - side / 2, 5 - side / 2, side, side])
    estimate = TargetEstimate(
        frame=1, id=1, state=TargetState.TRACKED, box_px=np.array([0, 0, 10.0, 10.0]),
        angle_rad=np.pi / 4, distance_px=0.0, distance_rate_px=0.0, similarity=1.0,
        velocity_px=np.zeros(2))
    np.testing.assert_allclose(estimate.envelope_px, envelope(estimate.box_px, np.pi / 4))
    unturned = np.array([3.3, 4.4, 5.5, 6.6])
    np.testing.assert_array_equal(envelope(unturned, 0.0), unturned)


def test_upright_box_has_no_rotation():
    box = np.array([0, 0, 2.0, 3.0])
    assert Target(id=1, frame=1, box_px=box).upright
    assert not Target(id=1, frame=1, box_px=box, angle_rad=0.01).upright
