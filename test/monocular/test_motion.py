# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Stops and starts: their frequency, and their effect."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereo_speed.monocular.boxes import Target
from stereo_speed.monocular.config import MonocularConfig
from stereo_speed.monocular.distance import DistanceField
from stereo_speed.monocular.motion import EnvironmentMotion, PlainMotion, stop_and_start
from stereo_speed.monocular.particles import first_particles

COUNT = 20000
SCALE = 20.0  # root of 10 x 40 px
STILL = MonocularConfig(velocity_noise=0.0, position_noise=0.0, prior_noise=10.0)


def particles(velocity):
    target = Target(id=1, frame=1, box_px=np.array([60.0, 60, 10, 40]))
    rng = np.random.default_rng(0)
    made = first_particles(target, COUNT, 0.0, np.full(COUNT, -200.0), rng)
    return target, replace(made, velocity_px=np.tile(np.array(velocity, float), (COUNT, 1)))


@pytest.mark.parametrize('frames', [1.0, 3.0])
def test_some_particles_stop_and_the_others_continue(frames):
    config = replace(STILL, stop_chance=0.1, start_chance=0.5)
    velocity, new = stop_and_start(particles((3, 4))[1], frames, config,
                                   np.random.default_rng(1))
    chance = 1 - 0.9 ** frames
    assert new.mean() == pytest.approx(chance, abs=4 * np.sqrt(chance * (1 - chance) / COUNT))
    assert np.all(velocity[new] == 0) and np.all(velocity[~new] == (3, 4))


@pytest.mark.parametrize('frames', [1.0, 3.0])
def test_stopped_particles_start_as_initially(frames):
    """A target slower than 0.3 of the spread, which is 2 px, stands."""
    config = replace(STILL, start_speed=0.1, stop_chance=0.5, start_chance=0.1)
    velocity, new = stop_and_start(particles((0.3, 0.4))[1], frames, config,
                                   np.random.default_rng(2))
    chance = 1 - 0.9 ** frames
    assert new.mean() == pytest.approx(chance, abs=4 * np.sqrt(chance * (1 - chance) / COUNT))
    assert np.all(velocity[~new] == (0.3, 0.4))
    np.testing.assert_allclose(velocity[new].mean(axis=0), 0, atol=8 / np.sqrt(new.sum()))
    np.testing.assert_allclose(velocity[new].std(axis=0), 0.1 * SCALE, rtol=0.1)


def test_zero_probability_means_no_change():
    for velocity in ((3, 4), (0, 0)):
        config = replace(STILL, stop_chance=0.0, start_chance=0.0)
        found, new = stop_and_start(particles(velocity)[1], 1.0, config, np.random.default_rng(3))
        assert not new.any() and np.all(found == velocity)


def test_stopped_target_keeps_its_position_and_distance(maps):
    """Both models: a stopped particle does not move, and d does not change."""
    config = replace(STILL, stop_chance=0.25, horizon_noise=0.0)
    target, before = particles((3, 0))
    field = DistanceField(maps.two_kinds(maps.pixels()[0] - 99.5))  # d = x - 99.5
    environment = EnvironmentMotion(field, config, target)
    for motion in (PlainMotion(config, True), environment):
        after, _ = motion.move(motion.start(before), 1.0, np.random.default_rng(4))
        stands = np.all(after.velocity_px == 0, axis=1)
        assert stands.mean() == pytest.approx(0.25, abs=0.02)
        np.testing.assert_allclose(after.point_px[stands], before.point_px[stands])
        np.testing.assert_allclose(after.point_px[~stands] - before.point_px[~stands],
                                   np.tile([[3.0, 0]], (np.sum(~stands), 1)), atol=0.05)
        if motion is environment:
            np.testing.assert_allclose(after.distance_rate_px[stands], 0, atol=1e-9)
            np.testing.assert_allclose(after.distance_rate_px[~stands], 3, atol=0.05)


def test_particle_far_up_does_not_affect_the_horizons_of_others(maps):
    """Its foot is above all horizons; only its own horizon is changed."""
    config = replace(STILL, horizon_noise=0.05, start_chance=0.0)
    target, old = particles((0, 0))
    old = replace(old, horizon_px=np.full(COUNT, 40.0))  # the feet are at 100
    field = DistanceField(maps.two_kinds(maps.pixels()[0] - 99.5))
    motion, points = EnvironmentMotion(field, config, target), old.point_px.copy()
    points[0, 1] = 20.0
    near, far = (motion.move(replace(old, point_px=p), 1.0, np.random.default_rng(5))[0]
                 for p in (old.point_px, points))
    np.testing.assert_array_equal(near.horizon_px[1:], far.horizon_px[1:])
    np.testing.assert_array_equal(near.size_px[1:], far.size_px[1:])
    assert far.horizon_px[0] == pytest.approx(17)  # 3 px above its foot
    assert near.horizon_px[1:].mean() == pytest.approx(40, abs=0.2)


def test_states_stay_finite_with_any_noise(maps):
    """A random walk of rates would overflow within 40 steps."""
    config = MonocularConfig(
        velocity_noise=1.0, position_noise=1.0, start_speed=2.0, stop_chance=0.0,
        size_noise=0.5, size_rate_noise=0.5, horizon_noise=0.5, width_spread=1.0,
        height_spread=1.0, prior_rounds=2)
    target = Target(id=1, frame=1, box_px=np.array([60.0, 60, 10, 40]))
    rng = np.random.default_rng(0)
    field = DistanceField(maps.two_kinds(maps.pixels()[0] - 99.5))
    for motion in (PlainMotion(config, True), EnvironmentMotion(field, config, target)):
        moved = motion.start(first_particles(target, 50, 2.0, np.full(50, -200.0), rng))
        for _ in range(100):
            moved, log_weights = motion.move(moved, 10.0, rng)
        for values in (moved.point_px, moved.size_px, moved.horizon_px, moved.velocity_px,
                       log_weights):
            assert np.isfinite(values).all()
        assert moved.size_px.min() >= 1 and moved.size_px.max() < 1e6
        assert np.abs(moved.point_px).max() < 1e6
