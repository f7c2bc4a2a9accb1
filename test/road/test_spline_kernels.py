# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The compiled splines of paths against scipy's, on a climbing bend and beyond its ends."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from stereo_speed.road import spline_kernels

pytest.importorskip('numba')
STEP_M, PIECES = 0.5, 60


@pytest.fixture(scope='module')
def curve():
    s = STEP_M * np.arange(PIECES + 1)
    points = np.stack([30 * np.sin(s / 30), -0.002 * s ** 2, 80 - 30 * (1 - np.cos(s / 30))], -1)
    ups = np.stack([0.001 * s, -np.ones_like(s), 0 * s], axis=-1)
    spline = CubicSpline(s, points)
    return spline.c, CubicSpline(s, ups).c, spline_kernels.unit(spline([s[0], s[-1]], 1))


@pytest.mark.parametrize('name', ['positions', 'frames', 'arc_lengths'])
def test_kernels_equal_the_splines(curve, name):
    c, ups, ends = (np.ascontiguousarray(a) for a in curve)
    s_m = np.array([-3.0, 0.0, 0.1, 14.9, 15.0, 30.0, 33.0])
    one = getattr(spline_kernels, name)
    args = (c, STEP_M, ends, s_m)
    if name == 'frames':
        args = (c, ups, STEP_M, s_m)
    if name == 'arc_lengths':
        frames = spline_kernels.plain_frames(c, ups, STEP_M, s_m)
        beside = spline_kernels.plain_positions(c, STEP_M, ends, s_m) + 1.7 * frames[..., 1]
        args = (c, STEP_M, ends, beside)
    got, wanted = one.compiled()(*args), one.plain(*args)
    np.testing.assert_allclose(got, wanted, rtol=1e-10, atol=1e-9)
    if name == 'arc_lengths':
        np.testing.assert_allclose(got, s_m, atol=1e-6)
