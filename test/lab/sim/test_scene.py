# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Exposures, places and truth of a scene: by hand, and for consistency."""
from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from stereo_speed.lab.sim.bodies import BODIES
from stereo_speed.lab.sim.config import RoadConfig, straight_config, VehicleConfig
from stereo_speed.lab.sim.kinematics import lateral_m, lateral_mps
from stereo_speed.lab.sim.scene import Place, SimScene, stamp_text, Vehicle
from stereo_speed.lab.sim.truth import TRUTH_COLUMNS

KNOTS = ((1.0, 0.5), (3.0, 3.5), (4.0, 3.5), (4.5, -1.0))


def _exposures(count, **changes):
    scene = SimScene(straight_config(**changes))
    return list(scene.exposures(count, np.random.default_rng(0)))


def test_exposures_by_hand():
    taken = _exposures(7, fps=5.0, drop=(1,), gaps_s=((0.6, 0.8),), right_delay_s=0.003,
                       origin_ns=10 ** 9)
    assert [e.t_s for e in taken] == pytest.approx([0.0, 0.4, 0.8, 1.0, 1.2])
    assert [e.stamp_ns for e in taken] == [10 ** 9 + k * 10 ** 8 for k in (0, 4, 8, 10, 12)]
    assert {e.right_stamp_ns - e.stamp_ns for e in taken} == {3_000_000}


def test_stamps_jitter_as_configured_and_keep_their_order():
    taken = _exposures(400, fps=10.0, stamp_jitter_s=0.01, right_stamp_jitter_s=2e-4)
    off_s = np.array([e.t_s for e in taken]) - np.arange(400) / 10
    # The standard deviation of 399 draws is known to 3.5 %.
    assert off_s[0] == 0.0 and np.std(off_s[1:]) == pytest.approx(0.01, rel=0.14)
    skew_ns = np.array([e.right_stamp_ns - e.stamp_ns for e in taken])
    assert np.abs(skew_ns).max() <= 200_000 < 10 * skew_ns.std()
    wild = _exposures(400, fps=10.0, stamp_jitter_s=1.0)
    assert np.diff([e.stamp_ns for e in wild]).min() > 0
    assert all(e.stamp_ns % 1000 == 0 for e in wild)


def test_stamp_text():
    assert stamp_text(12_003_004_000) == '12.003004'


def test_drift_is_the_rate_of_the_offset():
    vehicle = VehicleConfig(lateral_knots=KNOTS)
    h = 1e-6
    for t_s in (0.0, 1.2, 2.0, 2.9, 3.5, 4.2, 6.0):
        rate = (lateral_m(vehicle, t_s + h) - lateral_m(vehicle, t_s - h)) / (2 * h)
        assert lateral_mps(vehicle, t_s) == pytest.approx(rate, abs=1e-6)
    assert [lateral_m(vehicle, t) for t in (0.0, 1.0, 3.0, 3.7, 9.0)] == [0.5, 0.5, 3.5, 3.5, -1.0]
    assert lateral_mps(vehicle, 9.0) == 0.0
    assert lateral_m(VehicleConfig(lateral_knots=((2.0, 1.5),)), 0.0) == 1.5


@pytest.mark.parametrize('receding', [(), (0,)])
def test_front_heads_in_its_direction_of_motion(receding):
    """Its travel axis is the direction in which the point below it moves."""
    scene = SimScene(straight_config(
        road=RoadConfig(grade=0.04, receding=receding),
        vehicles=(VehicleConfig(speed_mps=10.0, lateral_knots=((0.0, 0.0), (2.0, 3.0))),)))
    vehicle = scene.vehicles[0]
    step = scene.front(vehicle, 1.001).ground_m - scene.front(vehicle, 0.999).ground_m
    pose = scene.front(vehicle, 1.0)
    np.testing.assert_allclose(pose.axes[:, 0], step / np.linalg.norm(step), atol=1e-5)
    np.testing.assert_allclose(pose.axes.T @ pose.axes, np.eye(3), atol=1e-12)
    assert pose.rear == bool(receding)
    across = pose.corners_m[1] - pose.corners_m[0]
    # From the image's left to its right, which is an approaching driver's left.
    assert across[0] > 0 and across @ pose.axes[:, 1] == pytest.approx(-1.8 if receding else 1.8)
    row = scene.truth(vehicle, 1.0, 0)
    assert row['lateral'] == pytest.approx(1.5)
    assert row['speed'] == pytest.approx(np.linalg.norm(step) / 0.002, rel=1e-6)
    assert set(row) == {*TRUTH_COLUMNS, 'stamp_ns'}


def test_width_in_the_image_by_hand():
    scene = SimScene(straight_config(camera_side_m=0.0, camera_pitch_deg=0.0))
    place = Place(scene.end_station_m - 18.5, 0.0, 0, 0.0, 0.0)
    vehicle = Vehicle(4, replace(BODIES['van'], width_m=2.0), lambda _: place)
    row = scene.truth(vehicle, 0.0, 5_000)
    assert row['z'] == pytest.approx(36.0) and row['speed'] == 0.0
    assert row['width_px'] == pytest.approx(1800.0 * 2.0 / 36.0)
    assert (row['vehicle'], row['stamp']) == (4, '0.000005')
    assert scene.in_view(vehicle, 0.0) and scene.visible(vehicle, 0.0)


@pytest.mark.parametrize('receding, wanted', [
    ((), [False, True, True, True]), ((0,), [False, True, True, False])])
def test_view_ends_at_the_ends_of_the_pass(receding, wanted):
    """An approaching vehicle may be visible before the start, a receding one not after it."""
    scene = SimScene(straight_config(road=RoadConfig(receding=receding)))

    def at(ahead_m):
        place = Place(scene.end_station_m + 17.5 - ahead_m, 0.0, 0, 20.0, 0.0)
        return Vehicle(0, BODIES['car'], lambda _: place)
    assert [scene.visible(at(ahead_m), 0.0) for ahead_m in (17.4, 17.6, 71.9, 72.1)] == wanted


def test_bodies_of_configs_have_a_roof_above_their_front():
    tall = VehicleConfig(front_height_m=2.5, clearance_m=0.3, relief_m=0.03,
                         texture_contrast=0.7).body
    assert tall.roof_m > 2.8 and tall.tracked_m(False) == tall.tracked_m(True) == 2.5
    assert (tall.relief_m, tall.contrast) == (0.03, 0.7)
    assert math.isclose(VehicleConfig(kind='van').body.roof_m, BODIES['van'].roof_m)
