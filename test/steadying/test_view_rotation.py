# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The rotation of one camera, against exactly drawn images."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.records import RigMotion
from stereo_speed.steadying.config import SteadyingConfig
from stereo_speed.steadying.view_rotation import ViewRotation

from .conftest import F_PX, HEIGHT, WIDTH

CONFIG = SteadyingConfig()
ANGLES = np.radians([[0.1, -0.05, 0.1], [-0.3, 0.2, 0.4], [0.0, 0.01, 0.0], [0.4, 0.3, -0.3]])


@pytest.fixture(scope='module')
def view(rig, take):
    """Return a left camera that has learnt its first image."""
    return ViewRotation(rig.left, take(0).left, CONFIG)


@pytest.mark.parametrize('angles', ANGLES, ids=['sways', 'more', 'little', 'knock of 7 px'])
def test_rotation_is_found_to_a_few_hundredths_of_a_pixel(angles, view, take):
    found = view.measure(take(1, RigMotion(tuple(angles))).left, np.zeros(3))
    off_px = F_PX * (found.angles_rad - angles)
    assert np.abs(off_px[:2]).max() < 0.03
    assert abs(off_px[2]) < 0.1  # of a point as far from the middle as the focal length


@pytest.mark.slow
def test_covariance_is_that_of_the_errors(view, take):
    rng, shares = np.random.default_rng(3), []
    for number in range(10):
        angles = np.radians(0.05) * rng.standard_normal(3)
        found = view.measure(take(10 + number, RigMotion(tuple(angles))).left, np.zeros(3))
        off = found.angles_rad - angles
        shares.append(float(off @ np.linalg.solve(found.covariance_rad2, off)) / 3)
    # The mean of 10 chi-square variables with 3 degrees of freedom, over 3, is 1 +- 0.26.
    assert np.mean(shares) < 1.8


def test_moving_objects_do_not_count(view, take):
    angles = np.radians([0.05, 0.02, -0.03])
    image = take(1, RigMotion(tuple(angles))).left.copy()
    # A third of the view is a vehicle: the same texture, gone elsewhere.
    part = slice(HEIGHT // 3, HEIGHT), slice(WIDTH // 4, 3 * WIDTH // 4)
    image[part] = np.roll(image, 5, axis=1)[part]
    found = view.measure(image, np.zeros(3))
    assert np.abs(F_PX * (found.angles_rad - angles))[:2].max() < 0.05


def test_sliding_reflections_of_lamps_do_not_count(rig, take):
    def lit(image, down_px):
        """Return the image with lamps reflected by a wet road."""
        v, u = np.mgrid[:HEIGHT, :WIDTH]
        light = sum(np.exp(-((u - lamp_u) ** 2 + (v - lamp_v - down_px) ** 2) / 8)
                    for lamp_u in range(40, 160, 20) for lamp_v in (260, 290))
        return np.clip(np.rint(image + 200 * light), 0, 255).astype(np.uint8)
    for number in (100, 102):
        first, then = (take(number + k, gain=0.5, noise=1.0).left for k in (0, 1))
        view = ViewRotation(rig.left, lit(first, 0.0), CONFIG)
        found = view.measure(lit(then, 0.5), np.zeros(3))
        assert np.abs(F_PX * found.angles_rad)[:2].max() < 0.03


@pytest.mark.slow
def test_uncertainty_in_a_dark_view_is_that_of_the_errors(rig, take):
    shares = []
    for number in range(8):
        first, then = (take(100 + 2 * number + k, gain=0.12, noise=1.0).left for k in (0, 1))
        found = ViewRotation(rig.left, first, CONFIG).measure(then, np.zeros(3))
        shares.append(float(found.angles_rad @ np.linalg.solve(
            found.covariance_rad2, found.angles_rad)) / 3)
    # The mean of 8 chi-square variables with 3 degrees of freedom, over 3, is 1 +- 0.29.
    assert np.mean(shares) < 1.9


def test_step_of_the_exposure_has_no_effect(view, take):
    angles = np.radians([0.05, 0.02, -0.03])
    one, other = (view.measure(take(1, RigMotion(tuple(angles)), gain=gain).left, np.zeros(3))
                  for gain in (1.0, 0.85))
    assert np.abs(F_PX * (one.angles_rad - other.angles_rad))[:2].max() < 0.02


@pytest.mark.parametrize('image', [
    np.full((HEIGHT, WIDTH), 7, np.uint8),
    np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH)).astype(np.uint8)],
    ids=['dark', 'another place'])
def test_image_without_the_scene_gives_no_rotation(image, view):
    assert view.measure(image, np.zeros(3)) is None


def test_flat_first_image_gives_no_rotation(rig, take):
    blind = ViewRotation(rig.left, np.zeros((HEIGHT, WIDTH), np.uint8), CONFIG)
    assert blind.measure(take(0).left, np.zeros(3)) is None


def test_sixteen_bit_images_are_as_accurate(rig, take):
    def wide(pair):
        return pair.left.astype(np.uint16) * 16
    angles = np.radians([0.05, 0.02, -0.03])
    view = ViewRotation(rig.left, wide(take(0)), CONFIG)
    found = view.measure(wide(take(1, RigMotion(tuple(angles)))), np.zeros(3))
    assert np.abs(F_PX * (found.angles_rad - angles))[:2].max() < 0.02


def test_slow_changes_of_the_scene_are_learnt(rig, take):
    config = SteadyingConfig(renew_pairs=3)
    view, first = ViewRotation(rig.left, take(0).left, config), take(0).left
    # The view is occluded column by column, finally completely.
    other = np.random.default_rng(1).integers(0, 255, first.shape).astype(np.uint8)
    for built in range(0, WIDTH + 1, 16):
        image = np.where(np.arange(WIDTH) < built, other, first).astype(np.uint8)
        found = view.measure(image, np.zeros(3))
        assert np.abs(F_PX * found.angles_rad[:2]).max() < 0.1
        view.learn(image, found)
