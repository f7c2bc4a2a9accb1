# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The environment prior (eq. 20-22): its sampler against the distribution derived by hand."""
from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from stereo_speed.monocular.boxes import Target
from stereo_speed.monocular.config import MonocularConfig
from stereo_speed.monocular.distance import DistanceField
from stereo_speed.monocular.motion import EnvironmentMotion
from stereo_speed.monocular.particles import first_particles
from stereo_speed.monocular.prior import accept_reject, log_acceptance

MEAN, STD = 1.2, 0.7  # of the acceptance, over candidates that are N(0, 1)
# the product of the two, normalised: a Gaussian again
WANTED = stats.norm(MEAN / (1 + STD ** 2), STD / np.sqrt(1 + STD ** 2))


def draw(count, rounds, seed, mean=MEAN):
    """Draw from N(0, 1) accepted by exp(-(x - mean)^2 / 2 std^2)."""
    rng = np.random.default_rng(seed)
    return accept_reject(
        lambda index: rng.standard_normal((len(index), 1)),
        lambda index, x: log_acceptance(x[:, 0], np.full(len(index), mean),
                                        np.full(len(index), STD)), count, rounds, rng)


def gap(values, log_weights, wanted):
    """Return the largest gap between the weighted and the wanted distribution function, and n."""
    order = np.argsort(values)
    weights = np.exp(log_weights[order])
    weights = weights / weights.sum()
    above = np.cumsum(weights)
    expected = wanted.cdf(values[order])
    largest = max(np.abs(above - expected).max(), np.abs(above - weights - expected).max())
    return largest, 1 / np.sum(weights ** 2)


def bound(count):
    """Return the Kolmogorov gap that one draw in 10 000 exceeds."""
    return 2.23 / np.sqrt(count)


def test_acceptance_equals_the_ratio_of_densities():
    distance = np.array([3.0, 4.0, 1.0, np.inf])
    expected, std = np.array([3.0, 3.0, 2.5, 3.0]), np.array([0.5, 0.5, 1.5, 0.5])
    found = log_acceptance(distance, expected, std)
    np.testing.assert_allclose(found, [0, -2, -0.5, -np.inf])
    wanted = stats.norm.pdf(distance, expected, std) / stats.norm.pdf(0, 0, std)
    np.testing.assert_allclose(np.exp(found), wanted)


def test_sampler_draws_from_the_product():
    found, log_weights = draw(20000, 100, seed=1)
    assert np.all(log_weights == 0)  # all accepted
    assert stats.kstest(found[:, 0], WANTED.cdf).pvalue > 1e-3
    # the test is sensitive: without the prior, with another width, with another mean
    for wrong in (stats.norm(0, 1), stats.norm(WANTED.mean(), 1.07 * WANTED.std()),
                  stats.norm(MEAN, WANTED.std())):
        assert stats.kstest(found[:, 0], wrong.cdf).pvalue < 1e-6


@pytest.mark.parametrize('rounds', [1, 2, 4])
def test_weights_keep_the_distribution_when_rounds_run_out(rounds):
    found, log_weights = draw(60000, rounds, seed=2)
    left = np.mean(log_weights < 0)
    chance = np.exp(-MEAN ** 2 / (2 * (1 + STD ** 2))) * STD / np.sqrt(1 + STD ** 2)
    assert left == pytest.approx((1 - chance) ** (rounds - 1), abs=0.02)
    largest, effective = gap(found[:, 0], log_weights, WANTED)
    assert largest < bound(effective)
    if rounds == 1:  # and the weights are needed for it
        assert gap(found[:, 0], np.zeros(60000), WANTED)[0] > 10 * bound(effective)


def test_each_index_has_its_own_prior():
    rng = np.random.default_rng(3)
    wanted = np.repeat([-2.0, 0.0, 3.0], 4000)
    found, log_weights = accept_reject(
        lambda index: wanted[index, None] + rng.standard_normal((len(index), 1)),
        lambda index, x: log_acceptance(x[:, 0], wanted[index], np.full(len(index), 0.5)),
        12000, 60, rng)
    assert np.all(log_weights == 0)
    for mean in (-2.0, 0.0, 3.0):
        mine = found[wanted == mean, 0]
        assert stats.kstest(mine, stats.norm(mean, 0.5 / np.sqrt(1.25)).cdf).pvalue > 1e-3


def test_unacceptable_samples_are_kept_with_hardly_any_weight():
    rng = np.random.default_rng(4)
    found, log_weights = accept_reject(
        lambda index: index[:, None].astype(float),
        lambda index, x: np.where(index % 2, 0.0, -np.inf), 10, 15, rng)
    np.testing.assert_array_equal(found[:, 0], np.arange(10))
    np.testing.assert_array_equal(log_weights[1::2], 0)
    assert np.all(log_weights[::2] < -700) and np.all(np.isfinite(log_weights))


def moved(field, config, point, velocity, frames, seed, count=20000):
    """Move particles that are all in one state; return them, their weights and their size."""
    target = Target(id=1, frame=1, box_px=np.array([point[0] - 8, point[1] - 4, 16, 8.0]),
                    angle_rad=0.5)
    rng = np.random.default_rng(seed)
    particles = first_particles(target, count, 0.0, np.full(count, -100.0), rng)
    particles.velocity_px[:] = velocity
    motion = EnvironmentMotion(field, config, target)
    particles = motion.start(particles)
    found, log_weights = motion.move(particles, frames, rng)
    return found, log_weights, np.sqrt(16 * 8.0)


@pytest.mark.parametrize('frames', [1.0, 3.0])
@pytest.mark.parametrize('rounds', [2, 200])
def test_motion_draws_from_dynamics_times_prior(maps, frames, rounds):
    """Along columns: x is the product of eq. 19 and eq. 20, y that of eq. 19 alone."""
    field = DistanceField(maps.two_kinds(maps.pixels()[0] - 99.5))
    config = MonocularConfig(prior_rounds=rounds, velocity_noise=0.03, position_noise=0.04,
                             stop_chance=0.0, start_chance=0.0)
    found, log_weights, size = moved(field, config, (140.0, 60.0), (0.4, 3.0), frames, 5)
    free = size * np.sqrt(frames) * np.hypot(0.03 * frames, 0.04)
    prior = size * config.prior_noise * frames
    aside = stats.norm(140.0 + 0.4 * frames, 1 / np.hypot(1 / free, 1 / prior))
    for axis, wanted in enumerate((aside, stats.norm(60.0 + 3.0 * frames, free))):
        largest, effective = gap(found.point_px[:, axis], log_weights, wanted)
        assert largest < bound(effective)
    wrong = stats.norm(140.0 + 0.4 * frames, free)
    assert gap(found.point_px[:, 0], log_weights, wrong)[0] > 2 * bound(len(found))


def test_inaccessible_places_get_no_weight():
    labels = np.full((100, 100), 128, np.uint8)
    labels[:, 60:], labels[:, :20] = 0, 255
    field = DistanceField(labels)
    config = MonocularConfig(prior_noise=2.0, position_noise=0.5)
    found, log_weights, _ = moved(field, config, (57.0, 50.0), (0.0, 1.0), 1.0, 6, count=2000)
    weight = np.exp(log_weights)
    barred = ~field.accessible(found.point_px)
    assert weight[barred].sum() < 1e-100 < weight.sum()
    # without the walls a third would be there
    free = moved(DistanceField(np.where(labels == 0, 128, labels).astype(np.uint8)), config,
                 (57.0, 50.0), (0.0, 1.0), 1.0, 6, count=2000)[0]
    assert np.mean(free.point_px[:, 0] > 59.5) > 0.2
