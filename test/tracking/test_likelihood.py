# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The batch likelihood on a rendered pair."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.tracking.likelihood import Reference, score
from stereo_speed.vision.haar import PartGrid

GRID, CONFIG = PartGrid(), TrackerConfig()


def quads_of(textured, pose, shift_px=(0.0, 0.0)):
    left, right = textured.quads(pose)
    return left[None] + shift_px, right[None] + shift_px


def test_true_position_is_the_most_likely(textured, textured_drive):
    (first, second), poses = textured_drive[0][6:8], textured_drive[1]
    at = score(first.left, first.right, quads_of(textured, poses[6]), None, grid=GRID,
               config=CONFIG)
    reference = Reference(at.left[0], at.right[0])
    shifts = [(0, 0), (2, 0), (-2, 0), (0, 2), (0, -2), (6, 0)]
    quads = [np.concatenate(side) for side in
             zip(*(quads_of(textured, poses[7], s) for s in shifts))]
    scores = score(second.left, second.right, tuple(quads), reference, grid=GRID, config=CONFIG)
    assert int(np.argmax(scores.log_likelihood)) == 0
    # Both views moved alike keep their agreement only on the vehicle, never its features.
    assert scores.log_likelihood[0] - scores.log_likelihood[5] > 3
    assert scores.cross_ncc[0] > 0.95


def test_likelihood_equals_the_formula_of_the_paper(textured, textured_drive):
    """Eq. 13 and 18: squared distances to the reference and the lack of correlation, weighted."""
    (first, second), poses = textured_drive[0][6:8], textured_drive[1]
    quads = quads_of(textured, poses[7], (1.0, 0.0))
    alone = score(second.left, second.right, quads, None, grid=GRID, config=CONFIG)
    assert alone.log_likelihood[0] == pytest.approx(
        -CONFIG.lambda_c * (1 - alone.cross_ncc[0]) ** 2)
    at = score(first.left, first.right, quads_of(textured, poses[6]), None, grid=GRID,
               config=CONFIG)
    known = score(second.left, second.right, quads, Reference(at.left[0], at.right[0]),
                  grid=GRID, config=CONFIG)
    distance = np.sum((known.left[0] - at.left[0]) ** 2) + np.sum(
        (known.right[0] - at.right[0]) ** 2)
    assert known.log_likelihood[0] == pytest.approx(
        alone.log_likelihood[0] - CONFIG.lambda_d * distance, rel=1e-5)


def test_particles_out_of_view_are_impossible(textured, textured_drive):
    pair, pose = textured_drive[0][0], textured_drive[1][0]
    left, right = quads_of(textured, pose)
    behind = np.full_like(left, np.nan)
    far = left.mean(axis=1, keepdims=True) + 1e-6 * left  # a front kilometres away is a point
    scores = score(pair.left, pair.right,
                   (np.concatenate([left, behind, far]), np.concatenate([right, right, right])),
                   None, grid=GRID, config=CONFIG)
    assert np.isfinite(scores.log_likelihood[0])
    assert scores.log_likelihood[1:].tolist() == [-np.inf, -np.inf]
    none = score(pair.left, pair.right, (behind, right), None, grid=GRID, config=CONFIG)
    assert none.log_likelihood.tolist() == [-np.inf]


def test_reference_keeps_a_share_epsilon_of_the_previous_one():
    old, new = np.array([1.0, 0.0], np.float32), np.array([0.0, 1.0], np.float32)
    got = Reference(old, old).updated(new, new, 0.3)
    np.testing.assert_allclose(got.left, np.array([0.3, 0.7]) / np.hypot(0.3, 0.7), rtol=1e-6)
