# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The time between the views is found from moving drawn fronts, whatever the stamps are."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.core.records import StereoPair, TrackState, TrackUpdate
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.steadying.view_lag import _Look, _solve, ViewLag

SPEED_MPS, PERIOD_S = 22.0, 0.1
HALF_M = np.array([[-0.9, -0.6, 0.0], [0.9, -0.6, 0.0], [0.9, 0.6, 0.0], [-0.9, 0.6, 0.0]])
START_M, VELOCITY_MPS = np.array([-4.0, 4.0, 60.0]), SPEED_MPS * np.array([0.1, 0.0, -0.995])


@pytest.fixture(scope='module')
def rig():
    k = np.array([[1500.0, 0.0, 511.5], [0.0, 1500.0, 383.5], [0.0, 0.0, 1.0]])
    cameras = [Camera(name=n, width_px=1024, height_px=768, K=k, D=(), model='plumb_bob')
               for n in ('left', 'right')]
    return StereoRig(*cameras, np.eye(3), np.array([-0.5, 0.0, 0.0]))


@pytest.fixture(scope='module')
def texture():
    noise = np.random.default_rng(4).normal(128, 60, (120, 180))
    return cv2.GaussianBlur(noise, (0, 0), 2.0).clip(0, 255).astype(np.uint8)


def drawn(camera, points_m, texture, rng):
    """Draw a front at its corners (4, 3) in the camera's frame, with noise."""
    corners, _ = camera.project(points_m)
    height, width = texture.shape
    source = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
    warp = cv2.getPerspectiveTransform(source.astype(np.float32), corners.astype(np.float32))
    image = cv2.warpPerspective(texture, warp, (camera.width_px, camera.height_px),
                                flags=cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT,
                                borderValue=90)
    noisy = image.astype(np.float32)
    (x0, y0), (x1, y1) = corners.min(axis=0).astype(int) - 40, corners.max(axis=0).astype(int) + 40
    near = noisy[max(y0, 0):y1, max(x0, 0):x1]
    near += rng.normal(0, 2, near.shape)
    return noisy.clip(0, 255).astype(np.uint8), corners


def drive(rig, texture, true_lag_s, gaps_s, seed=0):
    """Move a front past; return the estimated lag after each pair, and the corrected pairs."""
    rng, watch, out = np.random.default_rng(seed), ViewLag(rig), []
    for k, gap_s in enumerate(gaps_s):
        time_s = k * PERIOD_S % 1.9
        now_m = START_M + VELOCITY_MPS * time_s
        later_m = now_m + VELOCITY_MPS * (true_lag_s if np.isscalar(true_lag_s)
                                          else true_lag_s[k])
        left, left_px = drawn(rig.left, now_m + HALF_M, texture, rng)
        right, _ = drawn(rig.right, rig.to_right(later_m + HALF_M), texture, rng)
        right_px, _ = rig.right.project(rig.to_right(now_m + HALF_M))
        ns = round(k * PERIOD_S * 1e9)
        pair = StereoPair(k, ns, ns + round(gap_s * 1e9), left, right)
        axes = np.column_stack([VELOCITY_MPS / np.linalg.norm(VELOCITY_MPS), [1, 0, 0],
                                [0, -1, 0]])
        corrected = watch.corrected(pair)
        watch.observe(corrected, [TrackUpdate(
            ns, 0, 'lane', TrackState.CONFIRMED, SPEED_MPS, 0.1, 0.0, 0.0, now_m, np.eye(3),
            axes, left_px, right_px)])
        out.append((corrected.right_lag_s, watch.state))
    return watch, out


@pytest.mark.parametrize('true_ms, stamped_ms', [(0, 5), (0, 20), (0, -5), (12, 12), (8, 3)])
def test_lag_of_a_driver_is_found_and_corrected(rig, texture, true_ms, stamped_ms):
    watch, found = drive(rig, texture, true_ms * 1e-3, [stamped_ms * 1e-3] * 19)
    lag_s, state = found[-1]
    assert state.std_s < 8e-4
    assert abs(lag_s - true_ms * 1e-3) < 4 * state.std_s
    assert abs(lag_s - true_ms * 1e-3) < 1e-3


@pytest.mark.parametrize('true_ms', [50, -50])
def test_curved_motion_and_a_growing_front_do_not_bias_the_lag(rig, texture, true_ms):
    """In 50 ms an approaching front and its motion grow by up to 5 %: 2 ms of the lag."""
    watch, found = drive(rig, texture, true_ms * 1e-3, [true_ms * 1e-3] * 19)
    times_s = np.array([one.across_px / (one.rate_px_s + one.bend_px_s2 * true_ms * 1e-3)
                        for one in watch._looks])
    assert len(times_s) > 15
    assert times_s == pytest.approx(true_ms * 1e-3, abs=2e-3)
    assert np.mean(times_s) == pytest.approx(true_ms * 1e-3, abs=7e-4)
    assert found[-1][0] == true_ms * 1e-3  # nothing to correct


def test_another_vehicle_improves_the_lag_more_than_further_looks():
    """Views of one front share errors: the thousandth adds little, another vehicle more."""
    def std_s(looks, tracks):
        rates_px_s = np.linspace(20.0, 300.0, looks)
        return _solve([_Look(k % tracks, 0.05, 0.05 * rate, rate, 0.0, 0.01)
                       for k, rate in enumerate(rates_px_s)], np.full(looks, 0.05)).std_s
    assert 0.015 * 0.05 < std_s(400, 1) < 0.05 * 0.05
    assert std_s(400, 1) == pytest.approx(std_s(100, 1), rel=0.1)
    assert std_s(400, 9) == pytest.approx(std_s(400, 1) / 3, rel=0.2)


def test_larger_misfit_gives_a_larger_sigma_even_with_few_looks_per_vehicle():
    """With few looks a vehicle's own errors are fitted to them and absorb part of the misfit."""
    def std_s(tracks, looks, noise):
        rng, out = np.random.default_rng(1), []
        for _ in range(40):
            own = rng.normal(0, 0.1, tracks)
            seen = [(k, rate) for k in range(tracks) for rate in rng.uniform(20.0, 300.0, looks)]
            out.append(_solve([
                _Look(k, 0.0, own[k] + rng.normal(0, 0.15 * noise), rate, 0.0, 0.01)
                for k, rate in seen], np.zeros(len(seen))).std_s)
        return np.mean(out)
    few, many = (std_s(tracks, looks, 3.0) / std_s(tracks, looks, 1.0)
                 for tracks, looks in ((60, 1), (5, 12)))
    assert many > 1.7
    assert few == pytest.approx(many, rel=0.06)


@pytest.mark.parametrize('to_constant', [False, True])
def test_change_of_the_model_alone_is_no_change_of_the_lag(rig, to_constant):
    """The right view is 30 ms later; its stamps scatter about that, or its exposures do too."""
    rng, watch = np.random.default_rng(5), ViewLag(rig)
    gaps_s, rates = 0.03 + rng.normal(0, 6e-3, 400), rng.uniform(40.0, 300.0, 400)
    lags_s = np.full(400, 0.03) if to_constant else gaps_s
    watch._gap_s, watch._constant = 0.03, not to_constant
    watch._applied = 0.0 if to_constant else 0.03
    watch._looks.extend(
        _Look(k % 9, gap_s, lag_s * rate + rng.normal(0, 0.05), rate, 0.0, 0.01)
        for k, (gap_s, lag_s, rate) in enumerate(zip(gaps_s, lags_s, rates)))
    watch._decide()
    assert watch._constant is to_constant
    assert watch.changes_s < 1.5e-3


def test_lag_is_unknown_before_anything_moves(rig):
    watch = ViewLag(rig)
    image = np.zeros((768, 1024), np.uint8)
    pair = StereoPair(0, 0, 5_000_000, image, image)
    assert watch.corrected(pair) is pair
    watch.observe(pair, [])
    assert watch.std_s == pytest.approx(0.02) and watch.state.looks == 0


@pytest.mark.slow
def test_stamp_jitter_is_separated_from_exposure_jitter(rig, texture):
    gaps_s = np.abs(np.random.default_rng(2).normal(0, 8e-3, 57)) + 1e-3
    by_arrival, found = drive(rig, texture, 0.0, gaps_s)
    assert by_arrival.state.constant and abs(found[-1][0]) < 1e-3
    exposed, found = drive(rig, texture, gaps_s, gaps_s)
    assert not exposed.state.constant
    assert found[-1][0] == pytest.approx(gaps_s[-1], abs=1e-3)


def test_pairs_of_one_trigger_are_unchanged(rig):
    watch = ViewLag(rig)
    image = np.zeros((768, 1024), np.uint8)
    pair = StereoPair(0, 7, 7, image, image)
    assert watch.corrected(pair) is pair and watch.state is None and watch.std_s == 0.0
