# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Sizes from the perspective, and the horizon from initial boxes."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereo_speed.monocular.boxes import Target
from stereo_speed.monocular.config import MonocularConfig
from stereo_speed.monocular.distance import DistanceField
from stereo_speed.monocular.motion import EnvironmentMotion, PlainMotion
from stereo_speed.monocular.particles import (
    first_particles, mean_box, Particles, reference_point)
from stereo_speed.monocular.perspective import (
    draw_horizons, horizon_posterior, perspective_growth)

STILL = MonocularConfig(
    velocity_noise=0.0, position_noise=0.0, angle_noise_deg=0.0, size_noise=0.0,
    size_rate_noise=0.0, horizon_noise=0.0, width_spread=0.0, height_spread=0.0,
    stop_chance=0.0, start_chance=0.0)


def target_at(number, foot, height, x=50.0):
    return Target(id=number, frame=1, box_px=np.array([x, foot - height, height / 3, height]))


def test_growth_by_hand():
    """50 rows below the horizon to 60: by a fifth; never more than twofold."""
    found = perspective_growth(np.array([150.0, 150.0, 150.0, 150.0, 90.0]),
                               np.array([160.0, 125.0, 400.0, 101.0, 120.0]), np.full(5, 100.0))
    np.testing.assert_allclose(found, [1.2, 0.5, 2.0, 0.5, 2.0])


def test_two_boxes_far_and_near_fix_the_horizon():
    """Heights 20 and 40 at rows 100 and 140: half the rows below row 60."""
    config = MonocularConfig(mark_height_spread=0.02, mark_ratio_spread=3.0)
    rows, p = horizon_posterior([target_at(1, 100, 20), target_at(2, 140, 40)], config)
    assert p.sum() == pytest.approx(1) and np.all(p >= 0)
    assert p @ rows == pytest.approx(60, abs=3)
    assert np.sqrt(p @ (rows - p @ rows) ** 2) < 6
    drawn = draw_horizons([target_at(1, 100, 20), target_at(2, 140, 40)], config, 5000,
                          np.random.default_rng(0))
    assert drawn.mean() == pytest.approx(p @ rows, abs=0.5)
    assert drawn.max() < 100


def test_one_box_gives_a_rough_guess():
    """At a quarter of the camera's height the horizon is four heights above its foot."""
    config = MonocularConfig(mark_ratio=0.25, mark_ratio_spread=0.4, mark_height_spread=0.3)
    rows, p = horizon_posterior([target_at(1, 200, 20)], config)
    log_above = np.log(200 - rows)
    mean = p @ log_above
    assert np.exp(mean) == pytest.approx(80, rel=0.02)
    assert np.sqrt(p @ (log_above - mean) ** 2) == pytest.approx(0.5, rel=0.02)


def test_posterior_against_integration_of_the_common_ratio():
    """Reference: the common logarithm of the ratio on a grid of its own."""
    config = MonocularConfig()
    targets = [target_at(1, 100, 18), target_at(2, 170, 45), target_at(3, 130, 33)]
    rows, p = horizon_posterior(targets, config)
    common = np.linspace(-4, 4, 1601)[None]
    total = -0.5 * (common / config.mark_ratio_spread) ** 2
    for foot, height in ((100, 18), (170, 45), (130, 33)):
        rest = np.log(height / (foot - rows))[:, None] - np.log(config.mark_ratio)
        total = total - 0.5 * ((rest - common) / config.mark_height_spread) ** 2
    wanted = np.exp(total).sum(axis=1)
    np.testing.assert_allclose(p, wanted / wanted.sum(), atol=1e-9)


def still_particles(target, velocity, horizon, count=4):
    particles = first_particles(target, count, 0.0, np.full(count, horizon),
                                np.random.default_rng(0))
    return replace(particles, velocity_px=np.tile(np.array(velocity, float), (count, 1)))


def test_upright_size_is_proportional_to_rows_below_the_horizon(maps):
    """From row 100 to 104, horizon at 60: by a tenth; so is its image speed."""
    field = DistanceField(maps.two_kinds(maps.pixels()[0] - 99.5))
    target = target_at(1, 100.0, 30.0, x=120.0)
    motion = EnvironmentMotion(field, STILL, target)
    start = motion.start(still_particles(target, (0, 4), 60.0))
    moved, log_weights = motion.move(start, 1.0, np.random.default_rng(1))
    np.testing.assert_allclose(moved.point_px, [[125.0, 104.0]] * 4, atol=1e-3)
    np.testing.assert_allclose(moved.size_px, [[11.0, 33.0]] * 4, rtol=1e-3)
    np.testing.assert_allclose(moved.velocity_px, [[0, 4.4]] * 4, atol=1e-3)
    np.testing.assert_allclose(log_weights, 0, atol=1e-6)


def test_rotated_box_keeps_its_size_and_rotates_with_the_contour(maps):
    field = DistanceField(maps.two_kinds(maps.circle_distance(50.0)))
    target = Target(id=1, frame=1, box_px=np.array([maps.CENTRE[0] + 55, maps.CENTRE[1] - 5,
                                                    10, 10.0]), angle_rad=np.pi / 2)
    motion = EnvironmentMotion(field, STILL, target)
    particles = motion.start(still_particles(target, (0, 4), -100.0))
    rng = np.random.default_rng(0)
    for _ in range(10):
        particles = motion.move(particles, 1.0, rng)[0]
    # ten chords of 4 px on a radius of 60 px
    wanted = 10 * 2 * np.degrees(np.arcsin(4 / 120))
    np.testing.assert_allclose(np.degrees(particles.angle_rad) - 90, wanted, atol=4)
    np.testing.assert_allclose(particles.size_px, 10)
    # the first step was along the tangent: outwards a little, and so it goes on
    outwards = 10 * (np.hypot(60, 4) - 60)
    radius = np.hypot(*(particles.point_px - maps.CENTRE).T)
    np.testing.assert_allclose(radius, 60 + outwards, atol=0.6)


@pytest.mark.parametrize('frames', [1.0, 3.0])
def test_plain_motion_without_noise_goes_straight_on(frames):
    target = Target(id=1, frame=1, box_px=np.array([20, 30, 10, 8.0]), angle_rad=0.3)
    start = replace(still_particles(target, (2, -1), 0.0), size_rate=np.tile([0.1, 0.0], (4, 1)),
                    spin_rad=np.full(4, 0.05))
    motion = PlainMotion(STILL, upright=False)
    moved, log_weights = motion.move(motion.start(start), frames, np.random.default_rng(0))
    np.testing.assert_allclose(moved.point_px, [[25 + 2 * frames, 34 - frames]] * 4)
    np.testing.assert_allclose(moved.velocity_px, [[2, -1]] * 4)
    np.testing.assert_allclose(moved.size_px, [[10 * np.exp(0.1 * frames), 8]] * 4)
    np.testing.assert_allclose(moved.angle_rad, 0.3 + 0.05 * frames)
    np.testing.assert_array_equal(log_weights, 0)
    upright = PlainMotion(STILL, upright=True).move(start, frames, np.random.default_rng(0))[0]
    np.testing.assert_array_equal(upright.angle_rad, start.angle_rad)


@pytest.mark.parametrize('frames', [1.0, 4.0])
def test_plain_motion_has_the_configured_spread(frames):
    """Velocity by 0.03 of the size per axis and square root of a frame, position by 0.02 more."""
    target = Target(id=1, frame=1, box_px=np.array([20, 30, 16, 4.0]))  # size 8
    config = replace(STILL, velocity_noise=0.03, position_noise=0.02)
    count = 20000
    moved = PlainMotion(config, upright=True).move(
        still_particles(target, (0, 0), 0.0, count), frames, np.random.default_rng(0))[0]
    root = np.sqrt(frames)
    np.testing.assert_allclose(moved.velocity_px.std(axis=0), 8 * 0.03 * root, rtol=0.03)
    np.testing.assert_allclose(moved.point_px.std(axis=0),
                               8 * root * np.hypot(0.03 * frames, 0.02), rtol=0.03)


def test_mean_of_particles_by_hand():
    """Sizes are averaged by their logarithm and rotations on the circle."""
    zeros = np.zeros((2, 2))
    particles = Particles(
        point_px=np.array([[10.0, 20.0], [14.0, 28.0]]), velocity_px=zeros,
        size_px=np.array([[2.0, 4.0], [8.0, 16.0]]), size_rate=zeros,
        angle_rad=np.radians([170.0, -170.0]), spin_rad=zeros[0], distance_rate_px=zeros[0],
        horizon_px=zeros[0], deviation=zeros)
    half = np.array([0.5, 0.5])
    box, angle = mean_box(particles, half, upright=True)
    np.testing.assert_allclose(box, [12 - 2, 24 - 8, 4, 8])
    assert angle == 0.0
    np.testing.assert_allclose(reference_point(box, True), [12, 24])
    box, angle = mean_box(particles, half, upright=False)
    np.testing.assert_allclose(box, [12 - 2, 24 - 4, 4, 8])
    assert abs(np.degrees(angle)) == pytest.approx(180)
    np.testing.assert_allclose(reference_point(box, False), [12, 24])
    np.testing.assert_allclose(mean_box(particles, np.array([0.75, 0.25]), True)[0][:2],
                               [11 - np.sqrt(2), 22 - 4 * np.sqrt(2)])


def test_resampled_particles_stay_consistent():
    target = Target(id=1, frame=1, box_px=np.array([20, 30, 16, 4.0]))
    particles = first_particles(target, 100, 0.1, np.arange(100.0), np.random.default_rng(0))
    weights = np.zeros(100)
    weights[[7, 40]] = 0.25, 0.75
    drawn = particles.resampled(weights, np.random.default_rng(1))
    assert len(drawn) == 100
    assert (np.sum(drawn.horizon_px == 7), np.sum(drawn.horizon_px == 40)) == (25, 75)
    np.testing.assert_array_equal(
        drawn.velocity_px, particles.velocity_px[drawn.horizon_px.astype(int)])
