# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Targets files: accepted ones, and bad ones."""
import math

import numpy as np
import pytest

from stereo_speed.core.errors import SiteError
from stereo_speed.io.targets_file import check_targets, load_targets
from stereo_speed.monocular.boxes import Target

TARGETS = """environment_targets: 1
targets:
- {id: 4, frame: 12, box: [10.5, 20, 30, 40.25]}
- {id: 0, frame: 1, box: [-5, 2, 8, 9], angle_deg: -30}
"""


def test_targets(written):
    first, second = load_targets(written(TARGETS))
    assert (first.id, first.frame, first.angle_rad, first.upright) == (4, 12, 0.0, True)
    np.testing.assert_array_equal(first.box_px, [10.5, 20, 30, 40.25])
    assert (second.id, second.frame, second.upright) == (0, 1, False)
    assert second.angle_rad == pytest.approx(-math.pi / 6)
    np.testing.assert_array_equal(second.box_px, [-5, 2, 8, 9])


@pytest.mark.parametrize(('old', 'new', 'told'), [
    ('environment_targets: 1', 'environment_targets: 2',
     'environment_targets: found 2, wanted 1'),
    ('environment_targets: 1', 'stereo_speed_site: 1', 'environment_targets: found nothing'),
    ('environment_targets: 1', 'environment_targets: [', 'file: found .*wanted readable YAML'),
    ('frame: 12', 'frame: 0', r'targets\[0\]\.frame: found 0, wanted the number of a frame, fro'),
    ('frame: 12', 'frame: 1.5', r'targets\[0\]\.frame: found 1\.5'),
    ('frame: 12, ', '', r'targets\[0\]\.frame: found nothing'),
    ('frame: 12', 'colour: red, frame: 12', r'targets\[0\]\.colour'),
    ('id: 4', 'id: 0', r'targets\[1\]\.id: found 0 twice, wanted a different id'),
    ('id: 4', 'id: car', r"targets\[0\]\.id: found 'car'"),
    ('30, 40.25]', '30]', r'targets\[0\]\.box: found 3 values, wanted x, y, w, h in px'),
    ('40.25', '0', r'targets\[0\]\.box: found \[.*\], wanted a width and height above 0 px'),
    ('40.25', '-3', 'wanted a width and height above 0'),
    ('40.25', '.nan', r'targets\[0\]\.box\[3\]: found nan, wanted a finite number'),
    ('10.5', 'left', r"targets\[0\]\.box\[0\]: found 'left', wanted a finite number"),
    ('10.5', 'true', r'targets\[0\]\.box\[0\]: found True, wanted a finite number'),
    ('-30', '.inf', r'targets\[1\]\.angle_deg: found inf, wanted a finite number'),
    ('- {id: 4', '- {id: 4, id: 5', 'given twice'),
    ('targets:\n', 'targets: 7\nold:\n', 'found'),
], ids=str)
def test_invalid_targets_are_refused(written, old, new, told):
    assert old in TARGETS
    path = written(TARGETS.replace(old, new, 1))
    with pytest.raises(SiteError, match=told) as raised:
        load_targets(path)
    assert str(raised.value).startswith(f'{path}: ') and '\n' not in str(raised.value)


@pytest.mark.parametrize('box', [(100, 20, 5, 5), (20, 80, 5, 5), (-5, 20, 5, 5),
                                 (20, -6, 5, 5)])
def test_target_outside_the_image(box):
    inside = Target(id=1, frame=1, box_px=np.array([-4.0, -4, 5, 5]))
    check_targets([inside], 100, 80, 'targets.yaml')
    outside = Target(id=2, frame=1, box_px=np.array(box, dtype=float))
    with pytest.raises(SiteError, match=r'targets\.yaml: targets\[1\]\.box: found .*100x80 px'):
        check_targets([inside, outside], 100, 80, 'targets.yaml')
