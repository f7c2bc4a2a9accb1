# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""NCC against numpy's correlation coefficient and OpenCV's template matching."""
from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_speed.vision.ncc import ncc


def test_equals_pearson_and_opencv():
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0, 255, (2, 5, 64)).astype(np.float32)
    got = ncc(a, b)
    for k in range(5):
        assert got[k] == pytest.approx(np.corrcoef(a[k], b[k])[0, 1], abs=1e-5)
        match = cv2.matchTemplate(a[k].reshape(8, 8), b[k].reshape(8, 8), cv2.TM_CCOEFF_NORMED)
        assert got[k] == pytest.approx(float(match[0, 0]), abs=1e-4)


def test_gain_offset_and_sign():
    a = np.array([[1.0, 2.0, 4.0, 8.0]], np.float32)
    assert ncc(a, 3 * a + 7)[0] == pytest.approx(1, abs=1e-6)
    assert ncc(a, -a)[0] == pytest.approx(-1, abs=1e-6)


def test_no_contrast_gives_zero_not_nan():
    flat = np.ones((1, 16), np.float32)
    assert ncc(flat, np.arange(16, dtype=np.float32)[None])[0] == 0
