# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Passes drawn at random, and the sequences built to the paper's descriptions."""
from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.scenes import draw_scene, MOST_ACROSS_MPS2
from stereo_speed.lab.evaluation.sequences import find_sequence, FPS, LANE_M, rate_std, SEQUENCES
from stereo_speed.lab.sim.config import RIGS
from stereo_speed.lab.sim.kinematics import lateral_m
from stereo_speed.lab.sim.scene import SimScene
from stereo_speed.lab.sim.sequence import picked_site
from stereo_speed.site.file import load_site
from stereo_speed.site.lane_paths import lane_paths
import yaml

SCENES = [draw_scene(3, number) for number in range(90)]


def sequence_scene(name):
    return SimScene(find_sequence(name).config())


def test_a_scene_follows_from_its_seed_and_number():
    assert draw_scene(3, 17) == SCENES[17]
    assert draw_scene(4, 17).config != SCENES[17].config


def test_draws_fill_the_range_that_is_promised():
    configs = [scene.config for scene in SCENES]
    for value, low, high in ((lambda c: c.vehicles[0].speed_mps / MPH_MPS, 20, 90),
                             (lambda c: c.camera_height_m, 2, 6), (lambda c: c.noise_grey, 1, 4)):
        values = np.array([value(c) for c in configs])
        assert low <= values.min() < low + 0.15 * (high - low)
        assert high >= values.max() > high - 0.15 * (high - low)
    assert {c.road.lanes for c in configs} == {1, 2, 3}
    assert {c.pick_std_px for c in configs} == {0.3}
    kinds = Counter(s.kinds['path'] for s in SCENES)
    assert set(kinds.values()) == {30}  # in turns
    assert Counter(s.kinds['rig'] for s in SCENES) == dict.fromkeys(RIGS, 18)


def test_nobody_drives_through_a_bend_faster_than_tyres_hold():
    for scene in SCENES:
        road, v = scene.config.road, scene.config.vehicles[0].speed_mps
        assert v ** 2 * abs(road.curvature_end) <= MOST_ACROSS_MPS2 + 1e-9


def test_sites_of_scenes_can_be_read(tmp_path):
    for scene in SCENES[:9:2]:
        sim = SimScene(scene.config)
        path = tmp_path / 'site.yaml'
        path.write_text(yaml.safe_dump(picked_site(sim, np.random.default_rng(scene.number))))
        lanes = lane_paths(load_site(path), sim.rig)
        assert len(lanes) == scene.config.road.lanes


def test_pan_turns_the_right_camera_to_either_side():
    pans = {draw_scene(3, n, pan_deg=0.02).config.rig_moved_deg for n in range(12)}
    assert pans == {(0.02, 0.0, 0.0), (-0.02, 0.0, 0.0)}


@pytest.mark.parametrize('name', SEQUENCES)
def test_all_vehicles_are_in_view_in_the_first_pair(name):
    scene = sequence_scene(name)
    assert len(scene.config.vehicles) == len(find_sequence(name).vehicles)
    assert all(scene.visible(vehicle, 0.0) for vehicle in scene.config.vehicles)
    assert scene.config.fps == FPS


def test_the_circle_turns_by_22_and_a_half_degrees_a_second():
    scene = sequence_scene('circle36')
    vehicle = scene.config.vehicles[0]
    ahead = [scene.front(vehicle, t).axes[:, 0] for t in (0.5, 1.5)]
    assert np.degrees(np.arccos(ahead[0] @ ahead[1])) == pytest.approx(22.5, abs=0.01)
    assert vehicle.speed_mps == pytest.approx(36 * MPH_MPS)


@pytest.mark.parametrize(('name', 'drift_m'), [('lane_change35', 0.15), ('lane_change30', 0.25)])
def test_lane_changes_drift_as_the_paper_says(name, drift_m):
    config = find_sequence(name).config()
    vehicle = config.vehicles[0]
    (begin_s, _), (end_s, across_m) = vehicle.lateral_knots
    assert across_m == LANE_M
    assert across_m / ((end_s - begin_s) * FPS) == pytest.approx(drift_m, abs=0.005)
    assert lateral_m(vehicle, config.pairs / FPS) == pytest.approx(LANE_M)
    seen = [SimScene(config).visible(vehicle, k / FPS) for k in range(config.pairs)]
    assert sum(seen) >= 29


def test_the_papers_noise_per_frame_is_a_rate_of_ours():
    # ten steps of a random walk at 10 pairs a second are as wide as five at 5
    assert rate_std(0.15, 5.0) * np.sqrt(1.0) == pytest.approx(0.15 * np.sqrt(5))
    assert rate_std(0.15, 5.0) == pytest.approx(0.335, abs=5e-4)
