# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Which view is sharper, for views blurred by known amounts."""
from __future__ import annotations

from dataclasses import replace
import math

import cv2
import numpy as np
import pytest
from stereo_speed.core.tracker_config import NoiseConfig
from stereo_speed.tracking.front import Front
from stereo_speed.tracking.observation import ObservationSampler
from stereo_speed.tracking.sharpness import (
    blur_log_likelihoods, equal_blurs_px, grown_blurs_px, likeliest_blurs, trial_blurs_px)
from stereo_speed.vision.haar import PartGrid

GRID = PartGrid(10, 8)
POSE = np.array([20.0, 0.1, 1.9])  # 40 m away
STILL = np.zeros(3)


def soft(image, px, gamma):
    """Return an image whose light is blurred."""
    light = cv2.GaussianBlur(image.astype(float) ** gamma, (0, 0), px)
    return np.rint(light ** (1 / gamma)).astype(np.uint16)


def seen(textured, left_px, right_px, noise=NoiseConfig()):
    """Return the estimated blurs, and the sampler, for images whose light is blurred so much."""
    sampler = ObservationSampler(textured.rig, Front(textured.path, textured.corners_m),
                                 GRID.unit_xy, GRID.shape, noise)
    pair = textured.pair(0, 0, POSE)
    left, right = (image if not px else soft(image, px, noise.gamma)
                   for image, px in ((pair.left, left_px), (pair.right, right_px)))
    pair = replace(pair, left=left, right=right)
    patches = sampler.blurred_patches(pair, POSE, STILL, trial_blurs_px(noise), [noise.gamma])
    return equal_blurs_px(blur_log_likelihoods(*patches, noise)[0], noise), sampler, pair


@pytest.mark.parametrize(('left_px', 'right_px'), [(0.0, 1.0), (0.0, 2.0), (1.5, 0.0)])
def test_sharper_view_is_blurred_to_match_the_other(textured, left_px, right_px):
    found, sampler, pair = seen(textured, left_px, right_px)
    assert found == pytest.approx((right_px, left_px), abs=0.25)

    def agreement(blur_px):
        sampler.blur_px = blur_px
        patches = sampler.observe(pair, POSE, STILL, 0.0, np.zeros(32)).patches
        return float(np.mean(patches[0] * patches[1]))
    assert 1 - agreement(found) < 0.5 * (1 - agreement((0.0, 0.0)))


@pytest.mark.parametrize('gamma', [1.0, 2.2])
def test_root_whose_blur_gains_most_counts(gamma):
    """By hand: the best shares gain 20 and 12; the other root says more of any blur."""
    rise = -np.abs(np.linspace(-1, 1, 9) - 0.5)  # its peak is at a share of 0.5
    of_light, of_grey = 40 * rise, 24 * rise + 100
    both = np.array([of_light, of_grey] if gamma == 2.2 else [of_grey, of_light])
    found, blurs_px = likeliest_blurs(both, NoiseConfig(gamma=2.2))
    assert found == gamma
    assert blurs_px == pytest.approx((math.sqrt(0.5) * NoiseConfig().most_blur_px, 0.0))
    assert likeliest_blurs(0.01 * both, NoiseConfig(gamma=2.2)) == (2.2, (0.0, 0.0))


@pytest.mark.parametrize(('blur_px', 'growth', 'wanted'), [
    ((2.0, 0.0), 1.0, (2.0, 0.0)), ((2.0, 0.0), 4.0, (4.0, math.sqrt(12))),
    ((0.0, 1.5), 4.0, (math.sqrt(6.75), 3.0)), ((2.0, 0.0), 0.25, (2.0, 0.0)),
    ((0.0, 0.0), 4.0, (0.0, 0.0))])
def test_blur_scales_with_the_size_of_the_front(blur_px, growth, wanted):
    """By hand: 4 px in the sharp view; the other has 2 px, and sqrt(16 - 4) more make it 4."""
    assert grown_blurs_px(blur_px, growth) == pytest.approx(wanted)


def test_defocused_front_looks_alike_near_and_far(textured):
    """A constant 2 px blur is smaller relative to the front at half the distance."""
    sampler = ObservationSampler(textured.rig, Front(textured.path, textured.corners_m),
                                 GRID.unit_xy, GRID.shape)
    near, still = POSE + [20.0, 0, 0], np.zeros(3)

    def agreement(covered_px):
        sampler.blur_px, sampler.blurred_at_px = (2.0, 0.0), covered_px
        far_left, near_right = (
            sampler.observe(pair, pose, still, 0.0, np.zeros(32)).patches[view]
            for view, pose in enumerate((POSE, near))
            for pair in [blurred_right(textured.pair(0, 0, pose))])
        return float(np.mean(far_left * near_right))
    seen = sampler.blurred_patches(textured.pair(0, 0, POSE), POSE, still,
                                   trial_blurs_px(NoiseConfig()), [1.0])
    assert 1 - agreement(seen[1]) < 0.5 * (1 - agreement(math.inf))


def blurred_right(pair):
    """Return a pair whose right camera is 2 px out of focus."""
    return replace(pair, right=cv2.GaussianBlur(pair.right, (0, 0), 2.0))


@pytest.mark.parametrize('blur_px', [0.0, 1.5])
def test_equally_sharp_views_stay_unchanged(textured, blur_px):
    assert seen(textured, blur_px, blur_px)[0] == (0.0, 0.0)


def test_blurring_can_be_disabled(textured):
    assert seen(textured, 0.0, 2.0, NoiseConfig(sharpness_sigmas=1000.0))[0] == (0.0, 0.0)


def test_front_out_of_view_has_no_patches(textured):
    _, sampler, pair = seen(textured, 0.0, 0.0)
    assert sampler.blurred_patches(pair, POSE + [500.0, 0, 0], STILL,
                                   trial_blurs_px(NoiseConfig()), [1.0]) is None
