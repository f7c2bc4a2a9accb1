# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Corners followed by optical flow across views and over time."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.lab.baselines.lucas_kanade import flow, FlowPoints, window_px
from stereo_speed.lab.baselines.settings import FlowSettings


def test_points_keep_their_numbers_and_their_positions(parallel, textured):
    first, second = textured(FlowPoints(parallel, FlowSettings()))
    textured.check(first, second, tolerance_px=0.05)


def test_number_of_points_is_limited(parallel, textured):
    for found in textured(FlowPoints(parallel, FlowSettings(most_points=7))):
        assert len(found.ids) == 7


@pytest.mark.parametrize('shift', [(0.3, -0.7), (1.8, 1.2)])
def test_flow_of_a_moved_texture(textured, shift):
    at = np.array([[100.0, 100.0], [200, 200], [150, 120]])
    there, good = flow(textured.view(np.zeros(2)), textured.view(np.array(shift)), at, 15, 0.3)
    assert good.all()
    np.testing.assert_allclose(there, at + shift, atol=FlowSettings().match_std_px)


def test_flow_that_fails_the_backward_check_is_refused(textured):
    at = np.array([[100.0, 100.0], [200, 200]])
    there, good = flow(textured.view(np.zeros(2)), np.full((384, 512), 90, np.uint8), at, 9, 0.3)
    assert there.shape == (2, 2) and not good.any()
    assert flow(there, there, at[:0], 9, 0.3)[0].shape == (0, 2)


def test_window_grows_with_the_front_within_limits():
    assert [window_px(w) for w in (10.0, 72.0, 1000.0)] == [9, 13, 21]
