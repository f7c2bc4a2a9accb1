# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Maxima of sampled parabolas, and samples without a maximum."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.vision.subpixel import parabola_peak


def test_vertex_of_a_parabola_is_exact():
    at = np.array([1.3, 2.0, 2.8])
    place, score = parabola_peak(1 - 0.1 * (np.arange(5)[:, None] - at) ** 2)
    assert place == pytest.approx(at)
    assert score == pytest.approx(1 - 0.1 * (np.round(at) - at) ** 2)


def test_maximum_at_an_end_is_at_the_end():
    scores = np.array([[1.0, 0.0], [0.5, 0.2], [0.2, 0.9]])
    assert parabola_peak(scores)[0].tolist() == [0.0, 2.0]


def test_flat_top_does_not_divide_by_zero():
    place, score = parabola_peak(np.array([[0.0], [1.0], [1.0], [0.0]]))
    assert 1.0 <= place[0] <= 2.0 and score[0] == 1.0
    assert np.isfinite(parabola_peak(np.ones((3, 2)))[0]).all()
