# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The sequences match the paper's descriptions."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.paper_sequences import (
    find_sequence, FPS, LANE_M, rate_std, SEQUENCES)
from stereo_speed.lab.sim.kinematics import lateral_m
from stereo_speed.lab.sim.scene import SimScene


def sequence_scene(name):
    return SimScene(find_sequence(name).config())


@pytest.mark.parametrize('name', SEQUENCES)
def test_all_vehicles_are_in_view_in_the_first_pair(name):
    scene = sequence_scene(name)
    assert len(scene.config.vehicles) == len(find_sequence(name).vehicles)
    assert all(scene.visible(vehicle, 0.0) for vehicle in scene.vehicles)
    assert scene.config.fps == FPS


def test_circle_turns_by_22_5_degrees_a_second():
    scene = sequence_scene('circle36')
    vehicle = scene.config.vehicles[0]
    ahead = [scene.front(scene.vehicles[0], t).axes[:, 0] for t in (0.5, 1.5)]
    assert np.degrees(np.arccos(ahead[0] @ ahead[1])) == pytest.approx(22.5, abs=0.01)
    assert vehicle.speed_mps == pytest.approx(36 * MPH_MPS)


@pytest.mark.parametrize(('name', 'drift_m'), [('lane_change35', 0.15), ('lane_change30', 0.25)])
def test_lane_changes_drift_as_in_the_paper(name, drift_m):
    config = find_sequence(name).config()
    vehicle = config.vehicles[0]
    (begin_s, _), (end_s, across_m) = vehicle.lateral_knots
    assert across_m == LANE_M
    assert across_m / ((end_s - begin_s) * FPS) == pytest.approx(drift_m, abs=0.005)
    assert lateral_m(vehicle, config.pairs / FPS) == pytest.approx(LANE_M)
    scene = SimScene(config)
    seen = [scene.visible(scene.vehicles[0], k / FPS) for k in range(config.pairs)]
    assert sum(seen) >= 29


def test_noise_per_frame_of_the_paper_is_converted_to_a_rate():
    # ten steps of a random walk at 10 pairs a second are as wide as five at 5
    assert rate_std(0.15, 5.0) * np.sqrt(1.0) == pytest.approx(0.15 * np.sqrt(5))
    assert rate_std(0.15, 5.0) == pytest.approx(0.335, abs=5e-4)


@pytest.mark.parametrize(('name', 'speeds_mph'), [
    ('straight55', [55]), ('circle36', [36]), ('straight36', [36]), ('curve28', [28]),
    ('two_vehicles', [50, 53]), ('lane_change35', [35]), ('lane_change30', [30])])
def test_vehicles_have_the_papers_speeds(name, speeds_mph):
    config = find_sequence(name).config()
    assert [v.speed_mps / MPH_MPS for v in config.vehicles] == pytest.approx(speeds_mph)
    assert config.name == name


def test_right_one_of_two_vehicles_is_visible_while_the_left_one_passes():
    scene = sequence_scene('two_vehicles')
    left, right = scene.vehicles
    assert left.place(0.0).lane == right.place(0.0).lane + 1
    both = [k for k in range(40) if scene.visible(left, k / FPS) and scene.visible(right, k / FPS)]
    assert len(both) >= 10


def test_unknown_name_is_refused():
    with pytest.raises(InputError, match='found moon, wanted straight55'):
        find_sequence('moon')
