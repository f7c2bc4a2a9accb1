# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The loop of the particle filters against the exact filter of a linear Gaussian model."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.core.records import TrackState
from stereo_speed.lab.baselines.constant_velocity import (
    correct, Gaussian, predict, transition)
from stereo_speed.lab.baselines.particle_tracker import ParticleTracker
from stereo_speed.lab.baselines.settings import MotionSettings

STD_M, RATE, PARTICLES = 0.3, 0.5, 4000


class Linear(ParticleTracker[MotionSettings]):
    """A model with position and velocity, whose position is measured with Gaussian errors."""

    Settings = MotionSettings
    freedom = 6

    def __init__(self, world, prior, measured):
        super().__init__(world.start, world.placed, MotionSettings())
        self.world, self.measured = world, measured
        root = np.linalg.cholesky(prior.cov)
        self.states = prior.mean + self.rng.standard_normal((PARTICLES, 6)) @ root.T

    def _move(self, dt_s):
        step = transition(dt_s, RATE ** 2 * np.eye(3))
        noise = self.rng.standard_normal(self.states.shape) @ np.linalg.cholesky(step.Q).T
        self.states = self.states @ step.F.T + noise

    def _score(self, pair):
        off = (self.states[:, :3] - self.measured[pair.index]) / STD_M
        return -0.5 * np.square(off).sum(axis=1)

    def _accept(self, pair):
        return True

    def _quads(self, states, lag_s=0.0):
        corners = states[:, None, :3] + self.world.corners_m @ self.world.axes[:, 1:].T
        return self.rig.project(corners)[:2]

    def _axes(self, states):
        return np.broadcast_to(self.world.axes, (len(states), 3, 3))

    def _centres(self, states):
        return states[:, :3]

    def _velocities(self, states):
        return states[:, 3:]


@pytest.fixture
def linear(scene):
    """Return a tracker, and the exact posteriors after each of six pairs."""
    def make(seed, miss=()):
        world = scene(seed=seed, particles=PARTICLES)
        prior = Gaussian(np.append(world.centre_m(0), [0.0, 0, -20]),
                         np.diag([0.5, 0.5, 1.0, 1.0, 0.5, 2.0]) ** 2)
        measured = np.array([world.centre_m(200_000_000 * k) for k in range(6)])
        measured += STD_M * np.random.default_rng(seed).standard_normal(measured.shape)
        step, belief, beliefs = transition(0.2, RATE ** 2 * np.eye(3)), prior, []
        for k, z in enumerate(measured):
            belief = predict(belief, step) if k else belief
            belief = belief if k in miss else correct(belief, z, STD_M ** 2 * np.eye(3))
            beliefs.append(belief)
        measured[list(miss)] = np.inf
        return world, Linear(world, prior, measured), beliefs
    return make


@pytest.mark.parametrize('miss', [(), (3,)], ids=['all seen', 'one missed'])
def test_means_and_covariances_equal_the_exact_filter(linear, miss):
    runs = 10
    total = np.zeros((6, 6))
    ratios = []
    for seed in range(runs):
        world, one, beliefs = linear(seed, miss)
        updates = world.run(one, 6)
        assert [k for k, u in enumerate(updates) if u.state is TrackState.COASTING] == list(miss)
        exact = beliefs[-1]
        off = np.linalg.solve(np.linalg.cholesky(exact.cov), one.filtered[-1].mean - exact.mean)
        total += np.outer(off, off)
        ratios.append(np.diag(one.filtered[-1].cov) / np.diag(exact.cov))
    # Monte Carlo errors are 1 / sqrt(N) of a sigma for independent particles; resampling in each
    # pair keeps at least half the effective particles and adds the errors of six pairs.
    most = np.sqrt(2 * 6 / PARTICLES)
    assert np.sqrt(np.trace(total) / (6 * runs)) < 1.5 * most
    assert np.mean(ratios, axis=0) == pytest.approx(1.0, abs=3 * most)


def test_missed_pair_leaves_the_particles_as_predicted(linear):
    world, one, _ = linear(0, (1,))
    one.update(world.pair(0))
    before = one.filtered[-1]
    missed = one.update(world.pair(1))
    expected = predict(before, transition(0.2, RATE ** 2 * np.eye(3)))
    assert missed.state is TrackState.COASTING
    np.testing.assert_allclose(missed.position_m, expected.mean[:3], atol=0.1)


def test_pass_is_smoothed(linear):
    world, one, _ = linear(0)
    world.run(one, 6)
    result = one.result()
    assert len(result.smoothed) == 6
    live = np.sqrt(one.filtered[0].cov[5, 5])
    assert next(iter(result.smoothed_std.values())) < live
    assert abs(result.speed_mps - world.speed_mps) < 4 * result.speed_std_mps
