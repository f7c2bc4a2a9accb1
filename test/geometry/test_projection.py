# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The compiled projection against plain numpy, for each lens, with points of every kind."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.projection import project, Projection
from stereo_speed.geometry.rig import StereoRig

pytest.importorskip('numba')
K = np.array([[800.0, 0.4, 500.0], [0, 810.0, 390.0], [0, 0, 1]])
LENSES = {
    'plumb_bob': [-0.28, 0.09, 1e-3, -5e-4, 0.01],
    'rational_polynomial': [0.2, -0.1, 1e-3, 2e-4, 0.02, 0.5, -0.08, 0.05, 1e-3, 1e-4, -2e-3,
                            1e-4],
    'equidistant': [0.01, -0.02, 0.003, -0.001]}


@pytest.mark.parametrize('rotated', [False, True])
@pytest.mark.parametrize('model', ['ideal', *LENSES])
def test_points_before_beside_and_behind_the_camera(model, rotated):
    rng = np.random.default_rng(8)
    angle = 0.02
    rotation = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0],
                         [-np.sin(angle), 0, np.cos(angle)]]) if rotated else None
    camera = Camera('left', 1024, 768, K, np.array(LENSES.get(model, [])),
                    'plumb_bob' if model == 'ideal' else model, rotation)
    points = rng.uniform([-9, -9, -2], [9, 9, 20], (300, 3))
    what = Projection.of(camera.lens, K, (1024, 768), rotation)
    assert what.known
    got, wanted = project.compiled()(points, *what), project.plain(points, *what)
    np.testing.assert_allclose(got[0], wanted[0], rtol=1e-9)
    np.testing.assert_array_equal(got[1], wanted[1])
    assert 0 < got[1].sum() < len(points)
    assert np.isnan(got[0]).any()


def test_tilted_sensor_is_left_to_the_lens():
    camera = Camera('left', 1024, 768, K, np.array([0.0] * 12 + [0.01, 0.02]),
                    'rational_polynomial')
    assert not Projection.of(camera.lens, K, (1024, 768), None).known
    uv, valid = camera.project(np.array([[0.1, 0.0, 5.0], [0.1, 0.0, -5.0]]))
    assert np.isfinite(uv[0]).all() and np.isnan(uv[1]).all()
    np.testing.assert_array_equal(valid, [True, False])


@pytest.mark.parametrize('model', ['ideal', *LENSES, 'tilted'])
def test_both_views_equal_those_of_each_camera(model):
    """For points that move on until the right view is exposed."""
    rng = np.random.default_rng(9)
    kind = {'ideal': 'plumb_bob', 'tilted': 'rational_polynomial'}.get(model, model)
    D = [0.0] * 12 + [0.01, 0.02] if model == 'tilted' else LENSES.get(model, [])
    left, right = (Camera(side, 1024, 768, K, np.array(D), kind) for side in ('left', 'right'))
    angle = 0.03
    R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0],
                  [-np.sin(angle), 0, np.cos(angle)]])
    rig = StereoRig(left, right, R, np.array([-0.5, 0.02, 0.01]))
    points = rng.uniform([-9, -9, -2], [9, 9, 20], (4, 75, 3))
    later = points + [0.1, 0.0, -0.4]
    for exposed in (points, later):
        got = rig.project(points, None if exposed is points else later)
        wanted = (*left.project(points), *right.project(exposed @ R.T + rig.t))
        for a, b in zip(got, (wanted[0], wanted[2], wanted[1], wanted[3])):
            np.testing.assert_allclose(a, b, rtol=1e-9)
        assert 0 < got[3].sum() < got[3].size
