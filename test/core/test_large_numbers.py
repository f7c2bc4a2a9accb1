# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Whole numbers beyond the range of floats are refused like any other out of bounds."""
from __future__ import annotations

import pytest
from stereo_speed.core.config import load_config
from stereo_speed.core.errors import InputError
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.core.units import is_finite
from stereo_speed.io.targets_file import load_targets
from stereo_speed.site.init_file import load_init

HUGE = ['1' + '0' * 400, '-1' + '0' * 400, '0x1' + '0' * 5000]


@pytest.mark.parametrize('number', HUGE, ids=['large', 'small', 'hexadecimal'])
@pytest.mark.parametrize(('load', 'text'), [
    (lambda path: load_config(path, TrackerConfig), 'particles: {}'),
    (lambda path: load_config(path, TrackerConfig), 'verdict: {{uncertain_share: {}}}'),
    (load_init, 'stereo_speed_init: 1\nvehicles:\n- frame: 0\n'
     '  left_image: [[{}, 0], [1, 0], [1, 1], [0, 1]]\n  right_image: []'),
    (load_init, 'stereo_speed_init: {}\nvehicles: []'),
    (load_targets, 'environment_targets: 1\ntargets: [{{id: 1, frame: 1, box: [{}, 1, 1, 1]}}]'),
], ids=['whole', 'float', 'point', 'version', 'box'])
def test_number_too_large_for_a_float_is_refused(tmp_path, load, text, number):
    path = tmp_path / 'file.yaml'
    path.write_text(text.format(number))
    with pytest.raises(InputError):
        load(path)


@pytest.mark.parametrize(('value', 'finite'), [
    (0, True), (-1e308, True), (2 ** 1023, True), (2 ** 1024, False), (-10 ** 400, False),
    (float('inf'), False), (float('nan'), False)])
def test_number_within_the_range_of_a_float_is_accepted(value, finite):
    assert is_finite(value) is finite
