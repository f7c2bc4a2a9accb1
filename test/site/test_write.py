# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The text of site files."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.passes import VehicleClass
from stereo_speed.core.units import parse_speed
from stereo_speed.site.extras import KnownLength, PointsApart, RigCorrection
from stereo_speed.site.file import LaneSpec, load_site, PickedLine, Site, SurveyedLine
from stereo_speed.site.write import site_text, speed_text
import yaml


@pytest.mark.parametrize('text', ['55 mph', '80 km/h', '22.2 m/s', '31.5 mph'])
def test_speeds_are_written_in_their_unit(text):
    assert speed_text(parse_speed(text)) == text


def test_speeds_that_are_round_in_no_unit_keep_every_digit():
    assert parse_speed(speed_text(23.456789012345)) == 23.456789012345


def test_what_belongs_to_a_lane_round_trips(tmp_path):
    limits = {VehicleClass.HEAVY_VEHICLE: 80 / 3.6, VehicleClass.VAN: 100 / 3.6}
    points = np.array([[0, 2, 50], [0, 2, 10.0]])
    site = Site('s', 'here', {'p': SurveyedLine('p', points)},
                (LaneSpec('l', None, None, 'p', 120 / 3.6, limits, 0.0213),))
    (tmp_path / 'site.yaml').write_text(site_text(site))
    assert load_site(tmp_path / 'site.yaml').lanes[0] == site.lanes[0]


def test_numbers_are_rounded_to_their_precision(tmp_path):
    """Pixels to 1e-4, metres to 1e-6, degrees to 1e-6, covariances to four digits."""
    uv = np.array([[100.123456, 300.0], [150.0, 400.0], [200.0, 500.0]])
    site = Site('s', 'here', {
        'a': PickedLine('a', uv, uv - [10.0, 0.0], np.full(3, 0.0123456), np.full(3, 0.5)),
        'p': SurveyedLine('p', np.array([[0, 2.00000049, 50], [0, 2, 10.0]]))},
        (LaneSpec('l', None, None, 'a', 25.0),),
        RigCorrection(np.radians([0.0123456789, 0.0, 0.0]), np.radians(1.0)**2 * np.diag(
            [1.23456e-7, 1e-8, 1e-9])),
        (KnownLength('k', 2.0, 0.01, PointsApart(uv[:2], uv[1:], None)),), {'focal_std': 0.001})
    data = yaml.safe_load(site_text(site))
    assert data['lines']['a']['left_image'][0] == [100.1235, 300.0]
    assert data['lines']['a']['left_std_px'] == [0.0123] * 3
    assert data['lines']['p'] == {'points_m': [[0.0, 2.0, 50.0], [0.0, 2.0, 10.0]]}
    assert data['rig_correction']['pan_deg'] == 0.012346
    assert data['rig_correction']['covariance_deg2'][0] == [1.235e-7, 0.0, 0.0]
    assert 'pick_std_px' not in data['known_lengths'][0]
    path = tmp_path / 'site.yaml'
    path.write_text(site_text(site))
    again = load_site(path)
    assert site_text(again) == site_text(site)
    assert again.known_lengths[0].of.pick_std_px is None
