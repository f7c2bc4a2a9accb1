# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Random passes are within the documented ranges, and cover them."""
from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.random_passes import draw_pass, MOST_ACROSS_MPS2
from stereo_speed.lab.sim.config import RIGS
from stereo_speed.lab.sim.scene import SimScene
from stereo_speed.lab.sim.sequence import picked_site
from stereo_speed.site.file import load_site
from stereo_speed.site.lane_paths import lane_paths
import yaml

DRAWN = [draw_pass(3, number) for number in range(90)]


def test_pass_is_determined_by_seed_and_number():
    assert draw_pass(3, 17) == DRAWN[17]
    assert draw_pass(4, 17).config != DRAWN[17].config


def test_draws_fill_the_promised_range():
    configs = [drawn.config for drawn in DRAWN]
    for value, low, high in ((lambda c: c.vehicles[0].speed_mps / MPH_MPS, 20, 90),
                             (lambda c: c.camera_height_m, 2, 6), (lambda c: c.noise_grey, 1, 4)):
        values = np.array([value(c) for c in configs])
        assert low <= values.min() < low + 0.15 * (high - low)
        assert high >= values.max() > high - 0.15 * (high - low)
    assert {c.road.lanes for c in configs} == {1, 2, 3}
    assert {c.pick_std_px for c in configs} == {0.3}
    kinds = Counter(s.kinds['path'] for s in DRAWN)
    assert set(kinds.values()) == {30}  # in turns
    assert Counter(s.kinds['rig'] for s in DRAWN) == dict.fromkeys(RIGS, 18)


def test_speed_limits_are_integers_near_the_speed():
    for drawn in DRAWN:
        number, unit = drawn.config.speed_limit.split()
        share = float(number) / (drawn.config.vehicles[0].speed_mps / MPH_MPS)
        assert unit == 'mph' and float(number) % 5 == 0
        assert 0.75 - 2.5 / 20 <= share <= 1.1 + 2.5 / 20  # rounded to 5 mph, from 20 mph on


def test_bend_speeds_are_within_the_grip_of_tyres():
    for drawn in DRAWN:
        road, v = drawn.config.road, drawn.config.vehicles[0].speed_mps
        assert v ** 2 * abs(road.curvature_end) <= MOST_ACROSS_MPS2 + 1e-9


@pytest.mark.slow
def test_sites_of_passes_are_readable(tmp_path):
    for drawn in DRAWN[:6:2]:
        sim = SimScene(drawn.config)
        path = tmp_path / 'site.yaml'
        path.write_text(yaml.safe_dump(picked_site(sim, np.random.default_rng(drawn.number))))
        lanes = lane_paths(load_site(path), sim.rig)
        assert len(lanes) == drawn.config.road.lanes


def test_pan_rotates_the_right_camera_to_either_side():
    pans = {draw_pass(3, n, pan_deg=0.02).config.rig_moved_deg for n in range(12)}
    assert pans == {(0.02, 0.0, 0.0), (-0.02, 0.0, 0.0)}


def test_drivers_brake_or_accelerate_in_view_on_the_same_roads():
    """All speeds begin as without, change at the given rates, and stay above walking pace."""
    kinds = Counter()
    for number, plain in enumerate(DRAWN):
        drawn = draw_pass(3, number, braking=True)
        kind, vehicle = drawn.kinds['driver'], drawn.config.vehicles[0]
        kinds[kind] += 1
        assert replace(vehicle, speed_knots=()) == plain.config.vehicles[0]
        assert replace(drawn.config, vehicles=plain.config.vehicles) == plain.config
        t, v = np.array(vehicle.speed_knots).T
        assert (np.diff(t) > 0).all() and v[0] == v[1] == vehicle.speed_mps and v.min() > 1.99
        seen_s = (plain.config.start_m - plain.config.near_m) / vehicle.speed_mps
        assert 0.1 * seen_s <= t[1] <= 0.7 * seen_s
        accel = np.diff(v) / np.diff(t)
        low, high = {'brakes hard': (-8, -5), 'brakes': (-5, -2), 'accelerates': (1, 3)}[kind]
        assert low <= accel[-1] <= high
        assert accel[1:-1] == pytest.approx(accel[-1] * np.arange(0.1, 1.0, 0.2))  # builds up
        assert t[-2] - t[1] == pytest.approx(0.25)
    assert min(kinds.values()) > 10 and kinds['accelerates'] < 40
