# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs and the exposure times of their views."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.records import StereoPair

IMAGE = np.zeros((2, 2), np.uint8)


@pytest.mark.parametrize(('late_ns', 'lag_s', 'error_s'), [
    (0, 0.0, 0.0), (300_000, 0.0, 3e-4), (-500_000, 0.0, -5e-4), (600_000, 6e-4, 0.0),
    (-40_000_000, -0.04, 0.0)])
def test_stamps_that_hardly_differ_are_one_exposure_and_an_error(late_ns, lag_s, error_s):
    pair = StereoPair(0, 10 ** 18, 10 ** 18 + late_ns, IMAGE, IMAGE).triggered(5e-4)
    assert (pair.right_lag_s, pair.stamp_error_s) == pytest.approx((lag_s, error_s), rel=1e-12)
    assert pair.triggered(5e-4) is pair
