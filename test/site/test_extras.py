# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Additional fields of refined site files: read, written, and refused by name."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.errors import SiteError
from stereo_speed.site.extras import DashPeriod, LinesApart
from stereo_speed.site.file import load_site
from stereo_speed.site.write import site_text
import yaml

LINE = {'left_image': [[100, 300], [150, 400], [200.5, 500]],
        'right_image': [[90, 300], [135, 400], [180, 500]]}
OTHER = {'left_image': [[300, 300], [450, 400], [600, 500]],
         'right_image': [[290, 300], [435, 400], [580, 500]]}
SITE = {
    'stereo_speed_site': 1, 'name': 'here',
    'lines': {'a': {**LINE, 'left_std_px': [0.02, 0.03, 1], 'right_std_px': [0.02, 0.03, 0.5]},
              'b': OTHER, 'p': {'points_m': [[0, 2, 50], [0, 2, 30], [0, 2, 10]]}},
    'lanes': [{'name': 'l0', 'right': 'a', 'left': 'b', 'speed_limit': '55 mph'},
              {'name': 'l1', 'path': 'p', 'speed_limit': '80 km/h'}],
    'rig_correction': {'pan_deg': 0.0199, 'tilt_deg': 0.0, 'roll_deg': -0.01,
                       'covariance_deg2': [[1e-7, 1e-9, 0], [1e-9, 2e-8, 0], [0, 0, 3e-6]]},
    'known_lengths': [
        {'between': ['a', 'b'], 'length_m': 3.7, 'std_m': 0.01},
        {'name': 'paint', 'dashes': 'a', 'length_m': 9, 'std_m': 0.02},
        {'left_image': [[1, 2], [3, 4]], 'right_image': [[1, 2], [3, 5]], 'length_m': 2,
         'std_m': 0.01, 'pick_std_px': 0.1}]}


def load(folder, data):
    """Write and read a site."""
    path = folder / 'site.yaml'
    path.write_text(data if isinstance(data, str) else yaml.safe_dump(data))
    return load_site(path)


def test_refined_site_round_trips(tmp_path):
    first = load(tmp_path, SITE)
    assert first.lines['a'].left_std_px.tolist() == [0.02, 0.03, 1.0]
    assert first.lines['b'].left_std_px is None
    np.testing.assert_allclose(np.degrees(first.correction.drift_rad), [0.0199, 0, -0.01])
    again = load(tmp_path, site_text(first))
    assert again.name == first.name and again.lanes == first.lanes
    for name, line in first.lines.items():
        assert type(line) is type(again.lines[name])
        for key, value in vars(line).items():
            other = getattr(again.lines[name], key)
            if value is None or key == 'name':
                assert value == other
            else:
                np.testing.assert_allclose(value, other)
    np.testing.assert_allclose(first.correction.covariance_rad2, again.correction.covariance_rad2)
    for a, b in zip(first.known_lengths, again.known_lengths):
        assert (a.name, a.length_m, a.std_m) == (b.name, b.length_m, b.std_m)
    of = [known.of for known in again.known_lengths]
    assert of[:2] == [LinesApart(('a', 'b')), DashPeriod('a')] and of[2].pick_std_px == 0.1
    np.testing.assert_allclose(of[2].right_px, [[1, 2], [3, 5]])


@pytest.mark.parametrize('place, value, message', [
    (['surprise'], 1, 'unknown key surprise'),
    (['lines', 'a', 'std'], 1, 'unknown key std'),
    (['lines', 'a', 'left_std_px'], [0.1, 0.1], 'lines.a.left_std_px: found 2 numbers, wanted 3'),
    (['lines', 'a', 'left_std_px'], [0.1, 0, 0.1], r'left_std_px\[1\]: found 0, wanted px'),
    (['lines', 'a', 'right_std_px'], 0.1, 'right_std_px: found 0.1, wanted a list'),
    (['lines', 'p', 'left_std_px'], [0.1], 'points_m: found image picks too'),
    (['rig_correction', 'pan_deg'], 3, r'rig_correction.pan_deg: found 3, wanted degrees'),
    (['rig_correction', 'pan_deg'], 'left', "pan_deg: found 'left'"),
    (['rig_correction', 'yaw_deg'], 0, 'unknown key yaw_deg'),
    (['rig_correction', 'covariance_deg2'], [[1, 0, 0], [0, 1, 0]], 'wanted at least 3'),
    (['rig_correction', 'covariance_deg2'], [[1, 0, 0], [0, -1, 0], [0, 0, 1]], '3x3 covariance'),
    (['known_lengths'], [], 'known_lengths: found an empty list'),
    (['known_lengths', 0, 'between'], ['a', 'c'], "between: found 'c', wanted one of a, b, p"),
    (['known_lengths', 0, 'between'], ['a', 'a'], 'wanted two lines'),
    (['known_lengths', 0, 'between'], ['a', ['b']], 'between: found a list, wanted one of a, b'),
    (['known_lengths', 0, 'dashes'], 'a', 'found between and dashes'),
    (['known_lengths', 0, 'std_m'], 0, 'std_m: found 0'),
    (['known_lengths', 1, 'length_m'], None, 'length_m: found nothing'),
    (['known_lengths', 2, 'left_image'], [[1, 2], [3, 4], [5, 6]], 'found 3 points, wanted 2'),
])
def test_refusals(tmp_path, place, value, message, put):
    with pytest.raises(SiteError, match=message):
        load(tmp_path, put(SITE, place, value))
