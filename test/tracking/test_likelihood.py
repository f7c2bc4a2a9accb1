# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The batch likelihood on a rendered pair."""
from __future__ import annotations

import numpy as np

from stereo_speed.core.config import TrackerConfig
from stereo_speed.tracking.likelihood import Reference, score
from stereo_speed.vision.haar import PartGrid

GRID, CONFIG = PartGrid(), TrackerConfig()


def quads_of(sequence, pair, shift_px=(0.0, 0.0)):
    mark = sequence.scene.front(sequence.config.vehicles[0],
                                (pair.stamp_ns - sequence.pairs[0].stamp_ns) * 1e-9)
    left, right, _, _ = sequence.rig.project(mark.corners_m)
    return left[None] + shift_px, right[None] + shift_px


def test_the_true_place_is_the_most_likely(straight):
    first, second = straight.pairs[6], straight.pairs[7]
    at = score(first.left, first.right, quads_of(straight, first), None, grid=GRID,
               config=CONFIG)
    reference = Reference(at.left[0], at.right[0])
    shifts = [(0, 0), (2, 0), (-2, 0), (0, 2), (0, -2), (6, 0)]
    quads = [np.concatenate(side) for side in
             zip(*(quads_of(straight, second, s) for s in shifts))]
    scores = score(second.left, second.right, tuple(quads), reference, grid=GRID, config=CONFIG)
    assert int(np.argmax(scores.log_likelihood)) == 0
    # Both views moved alike keep their agreement only on the vehicle, never its features.
    assert scores.log_likelihood[0] - scores.log_likelihood[5] > 3
    assert scores.cross_ncc[0] > 0.95


def test_particles_not_seen_are_impossible(straight):
    pair = straight.pairs[0]
    left, right = quads_of(straight, pair)
    hidden = np.full_like(left, np.nan)
    scores = score(pair.left, pair.right,
                   (np.concatenate([left, hidden]), np.concatenate([right, right])), None,
                   grid=GRID, config=CONFIG)
    assert np.isfinite(scores.log_likelihood[0]) and scores.log_likelihood[1] == -np.inf


def test_reference_keeps_epsilon_of_the_old():
    old, new = np.array([1.0, 0.0], np.float32), np.array([0.0, 1.0], np.float32)
    got = Reference(old, old).updated(new, new, 0.3)
    np.testing.assert_allclose(got.left, np.array([0.3, 0.7]) / np.hypot(0.3, 0.7), rtol=1e-6)
