# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The tracker's compiled kernels against plain numpy and scipy."""
from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.tracking import motion_answers, observation_kernels, photometric_terms
from stereo_speed.tracking.motion_prior import motion_models, PassMotion, PassPrior, slopes

pytest.importorskip('numba')
RNG = np.random.default_rng(4)
ROWS, COLUMNS, N = 6, 10, 7
G = ROWS * COLUMNS


def agree(one, *args, rtol=1e-9, atol=1e-11):
    """Compare, relative to the greatest value of each result."""
    got, wanted = one.compiled()(*args), one.plain(*args)
    if not isinstance(got, tuple):
        got, wanted = (got,), (wanted,)
    assert len(got) == len(wanted)
    for a, b in zip(got, wanted):
        size = max(float(np.abs(b).max()), 1.0)
        np.testing.assert_allclose(a / size, b / size, rtol=rtol, atol=atol)


@pytest.fixture(scope='module')
def observations():
    """Return patches of a texture: outliers, outlines, glare in two, and one not counted."""
    texture = RNG.standard_normal(G)
    patches = texture + 0.2 * RNG.standard_normal((N, 2, G))
    patches[2, :, :9] += 4.0
    patches -= patches.mean(axis=-1, keepdims=True)
    patches /= patches.std(axis=-1, keepdims=True)
    outlines = np.zeros((N, 2, G))
    outlines[3] = RNG.standard_normal((2, G))
    outlines[3] /= np.linalg.norm(outlines[3], axis=1, keepdims=True)
    glare = np.zeros((N, 2, G))
    glare[3], glare[4, 0, :20] = RNG.uniform(0, 1, (2, G)), 1.0
    pixels = RNG.uniform(30, G, N)
    pixels[5] = 0.0
    return (patches, RNG.standard_normal((N, 2, 3, G)), RNG.standard_normal((N, 2, G)), outlines,
            glare, RNG.standard_normal(G), 0.02 * RNG.standard_normal((N, G)), pixels)


def test_temporal_terms(observations):
    rows = np.array([3, 0, 1, 6, 2, 5, 4])
    agree(photometric_terms._temporal, rows, *observations, RNG.uniform(5, 20, N), 3.0, 0.3, 0.02,
          0.5)
    agree(photometric_terms._temporal, rows[:4], *observations[:7], observations[7][:4],
          RNG.uniform(5, 20, N), 3.0, 0.3, 0.02, 0.5)


def test_temporal_terms_of_one_view(observations):
    """As for views that are exposed at different times."""
    patches, jacobian, by_relief, outlines, glare, by_blur, relief, pixels = observations
    agree(photometric_terms._temporal, np.array([3, 0, 1, 6, 2, 5, 4]), patches[:, :1].copy(),
          jacobian[:, :1].copy(), by_relief[:, :1].copy(), outlines[:, :1].copy(),
          glare[:, :1].copy(), by_blur, relief, pixels, RNG.uniform(5, 20, N), 3.0, 0.3, 0.02,
          0.5)


@pytest.mark.parametrize('outlined', ['none', 'both', 'left', 'alike'])
def test_cross_terms(observations, outlined):
    patches, jacobian, by_relief, outlines, _, _, relief, _ = observations
    lines = outlines[0 if outlined == 'none' else 3].copy()
    if outlined == 'left':
        lines[1] = 0
    if outlined == 'alike':
        lines[1] = -lines[0]
    for moves in (jacobian[3, 0], jacobian[3].reshape(6, G)):
        agree(photometric_terms._cross, patches[3], moves, by_relief[3, 0], lines, relief[3],
              40.0, 3.0, 0.3)


@pytest.mark.parametrize('first', [4.2, -1.5])
@pytest.mark.parametrize('lit', ['', 'left', 'right', 'both'])
@pytest.mark.parametrize('gamma', [1.0, 2.2])
def test_views(first, lit, gamma):
    """Points within the crop, and some beyond it, as at the edge of an image."""
    origins = np.array([[100.0, 20.0], [60.0, 25.0]])
    v, u = (a.ravel() for a in np.meshgrid(
        np.linspace(first, 41.0, ROWS), np.linspace(first, 61.5, COLUMNS), indexing='ij'))
    args = []
    for side in ('left', 'right'):
        image = cv2.GaussianBlur(RNG.uniform(0, 255, (40, 60)).astype(np.float32), (0, 0), 1.2)
        near = cv2.GaussianBlur((image > 160).astype(np.float32), (0, 0), 2.0)
        args += [image, near if lit in (side, 'both') else np.zeros((0, 0), np.float32)]
    # slopes are of single precision
    agree(observation_kernels.views, *args, origins, np.stack([u, v]) + origins[:, :, None],
          100 * RNG.standard_normal((2, 6, G, 2)), RNG.uniform(1, 6, (2, 2)), gamma, 10.0,
          atol=1e-7)


def test_spread():
    y, x = np.mgrid[:ROWS, :COLUMNS]
    at = np.stack([x.ravel() * 3.1 + y.ravel(), y.ravel() * 2.2 + 50], axis=-1)
    left, right = (
        np.concatenate([at, [[0, 50], [33, 52], [31, 70], [1, 66]]]) * scale
        + 1e-3 * RNG.standard_normal((4, 1, 2)) + 1e-5 * RNG.standard_normal((4, G + 4, 2))
        for scale in (1.0, 0.7))
    agree(observation_kernels.spread, left, right, ROWS, COLUMNS, 1e-4)


def test_points_of_fronts():
    agree(observation_kernels.points, RNG.standard_normal((4, 3)),
          RNG.standard_normal((4, 3, 3)), RNG.standard_normal((4, 2)),
          RNG.standard_normal((G, 3)))


@pytest.mark.parametrize('count', [1, 2, 9, 24])
@pytest.mark.parametrize('changes', [
    {}, {'smooth_ride_std_m': 0.05},
    {'manoeuvre_across_std_m': 0.0, 'acceleration_std_mps2': 0.0, 'cruise_rate_std': 0.0}])
def test_motion_model_answers_in_parts_equal_the_full_system(count, changes):
    """Each with its own 1-sigmas, with and without evidence about speeds."""
    rng = np.random.default_rng(count)
    motion = PassMotion(
        PassPrior(s_m=1.0, s_std_m=2.0, offset_m=np.array([0.1, 0.2]),
                  offset_slope=np.array([0.01, -0.02]), speed_mps=20.0, speed_std_mps=5.0,
                  heading_std_rad=np.array([1e-3, 2e-3])), TrackerConfig(**changes), 1e-4)
    times = np.cumsum(rng.uniform(0.02, 0.2, count))
    state = np.column_stack([20 * times, 0.1 * times, 0 * times, 20 + 0 * times])
    state += rng.normal(0, 0.05, state.shape)
    rows = rng.standard_normal((3 * count, 6 * count)) * np.tile([5, 60, 60], count)[:, None]
    H, begun = rows @ rows.T, motion.beginning(count)
    models = np.array([[np.nan if m.speed_rate_std is None else m.speed_rate_std,
                        m.changes_lanes, m.ride_std_m] for m in motion_models(motion.config)])
    levels = np.stack([H, 0.5 * H])
    said = np.arange(len(models)) % 2
    args = (levels, levels @ state[:, :3].ravel(), begun.H, begun.g, begun.log_rows, times, state,
            models, said, np.array(motion.processes), 1)
    got, wanted = motion_answers._answers.compiled()(*args), motion_answers.plain_answers(*args)
    std = np.sqrt(np.diagonal(wanted[2], axis1=1, axis2=2))
    np.testing.assert_allclose(got[0], wanted[0], atol=1e-4)
    np.testing.assert_allclose(got[1] / std, wanted[1] / std, atol=1e-6)
    np.testing.assert_allclose(got[2] / (std[:, :, None] * std[:, None]),
                               wanted[2] / (std[:, :, None] * std[:, None]), atol=1e-7)


def test_empty_speed_evidence_does_not_change_the_answers():
    """Evidence about speeds takes the path through all unknowns; empty, it changes nothing."""
    motion = PassMotion(
        PassPrior(s_m=1.0, s_std_m=2.0, offset_m=np.array([0.1, 0.2]),
                  offset_slope=np.array([0.01, -0.02]), speed_mps=20.0, speed_std_mps=5.0,
                  heading_std_rad=np.array([1e-3, 2e-3])), TrackerConfig(), 1e-4)
    times, models = 0.1 * np.arange(5), motion_models(motion.config)
    state = np.column_stack([20 * times, 0 * times, 0 * times, 20 + 0 * times])
    rows = RNG.standard_normal((15, 30)) * np.tile([5, 60, 60], 5)[:, None]
    H, whole = rows @ rows.T, np.zeros((20, 20))
    whole[:15, :15] = H
    right = H @ state[:, :3].ravel()
    found, wanted = (motion_answers.answers(
        motion, times, state, models, [0] * len(models), one[None], said[None], covariances=True)
        for one, said in ((whole, np.append(right, np.zeros(5))), (H, right)))
    np.testing.assert_allclose(found.log_evidence, wanted.log_evidence, atol=1e-5)
    np.testing.assert_allclose(found.means, wanted.means, atol=1e-6)
    np.testing.assert_allclose(found.covariances, wanted.covariances, atol=1e-6)


@pytest.mark.parametrize('count', [3, 4, 30])
def test_slopes(count):
    times = np.cumsum(RNG.uniform(0.01, 0.5, count))
    agree(slopes, times, RNG.standard_normal(count), rtol=1e-7, atol=1e-9)
