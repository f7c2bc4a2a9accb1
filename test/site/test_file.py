# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reading of site files: accepted files, and errors by name."""
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stereo_speed.core.errors import InputError, SiteError
from stereo_speed.site.file import load_site
from stereo_speed.site.write import site_text

SAMPLE_SITE = Path(__file__).resolve().parents[2] / 'sample' / 'straight55' / 'site.yaml'
PICKS = {'left_image': [[100, 300], [150, 400], [200.5, 500]],
         'right_image': [[90, 300], [135, 400], [180, 500]]}
OTHER = {'left_image': [[300, 300], [450, 400], [600, 500]],
         'right_image': [[290, 300], [435, 400], [580, 500]]}
SITE = {'stereo_speed_site': 1, 'name': 'here', 'lines': {
    'a': PICKS, 'b': OTHER, 'p': {'points_m': [[0, 2, 50], [0, 2, 30], [0, 2, 10]]}},
    'lanes': [{'name': 'l0', 'right': 'a', 'left': 'b', 'speed_limit': '55 mph'},
              {'name': 'l1', 'path': 'p', 'speed_limit': '80 km/h'}]}


def test_site_is_read(write):
    """Lines, lanes and limits arrive as arrays and m/s."""
    site = load_site(write(SITE))
    assert site.name == 'here' and list(site.lines) == ['a', 'b', 'p']
    np.testing.assert_allclose(site.lines['a'].left_px, PICKS['left_image'])
    assert site.lines['p'].points_m.shape == (3, 3) and list(site.picked) == ['a', 'b']
    assert site.lanes[0].lines == ('a', 'b') and site.lanes[1].lines == ('p',)
    assert site.lanes[0].speed_limit_mps == pytest.approx(24.5872)


def test_name_is_optional(write, put):
    """The file's stem is the default."""
    assert load_site(write(put(SITE, ['name'], None))).name == 'file'


NAN, INF = float('nan'), float('inf')


@pytest.mark.parametrize('place, value, match', [
    (['stereo_speed_site'], 2, 'stereo_speed_site: found 2, wanted 1'),
    (['stereo_speed_site'], None, 'stereo_speed_site: found nothing'),
    (['stereo_speed_site'], True, 'stereo_speed_site: found True'),
    (['colour'], 'red', 'colour: found unknown key colour'),
    (['lines', 'a', 'width'], 3, 'lines.a.width: found unknown key width'),
    (['lanes', 0, 'limit'], '5 mph', r'lanes\[0\].limit: found unknown key limit'),
    (['lines'], None, 'lines: found none'),
    (['lines', 7], PICKS, 'lines: found name 7'),
    (['lines', 'a'], [1], 'lines.a: found a list'),
    (['lines', 'a', 'left_image', 1, 0], NAN, r'lines.a.left_image\[1\]: found nan'),
    (['lines', 'p', 'points_m', 2, 1], INF, r'lines.p.points_m\[2\]: found inf'),
    (['lines', 'a', 'left_image', 0, 0], 'x', r'lines.a.left_image\[0\]: found .x'),
    (['lines', 'a', 'left_image', 0, 0], True, r'lines.a.left_image\[0\]: found True'),
    (['lines', 'a', 'left_image', 0], [1, 2, 3], r'lines.a.left_image\[0\]: found 3 values'),
    (['lines', 'a', 'left_image'], [[1, 2]], 'lines.a.left_image: found 1 points'),
    (['lines', 'a', 'left_image'], [], 'lines.a.left_image: found an empty list'),
    (['lines', 'a', 'right_image'], None, 'lines.a.right_image: found nothing'),
    (['lines', 'a', 'points_m'], [[1, 2, 3]], 'lines.a.points_m: found image picks too'),
    (['lines', 'a', 'left_image'], PICKS['left_image'][::2] + PICKS['left_image'][1:2],
     r'lines.a.left_image\[2\]: found a point behind'),
    (['lines', 'a', 'left_image', 1], [100, 300], r'lines.a.left_image\[1\]: found a point'),
    (['lines', 'b', 'left_image'], [[180, 300], [150, 420], [130, 500]], 'a crossing with b'),
    (['lines', 'a', 'right_image'], [[0, 0], [90, 90], [120, 50], [90, 10], [0, 80]],
     'crosses itself'),
    (['lines', 'p', 'points_m'], [[0, 0, 3], [0, 0, 1]], r'lines.p.points_m: found 2.0 m'),
    (['lanes'], None, 'lanes: found nothing'),
    (['lanes', 0, 'name'], None, r'lanes\[0\].name: found nothing'),
    (['lanes', 0, 'right'], 'c', r'lanes\[0\].right: found \'c\', wanted one of a, b, p'),
    (['lanes', 0, 'left'], None, r'lanes\[0\].left: found nothing'),
    (['lanes', 0, 'left'], 'a', r'lanes\[0\].left: found the same line a'),
    (['lanes', 0, 'path'], 'p', r'lanes\[0\].path: found right or left too'),
    (['lanes', 1, 'name'], 'l0', 'lanes: found two lanes named l0'),
    (['lanes', 0, 'speed_limit'], '55 knots', r"lanes\[0\].speed_limit: found '55 knots'"),
    (['lanes', 0, 'speed_limit'], None, r'lanes\[0\].speed_limit: found nothing'),
    (['lanes', 0, 'class_limits'], {'lorry': '80 km/h'},
     r'lanes\[0\].class_limits.lorry: found unknown key lorry, wanted one of motor'),
    (['lanes', 0, 'path_std'], -0.01,
     r'lanes\[0\].path_std: found -0.01, wanted share in \[0, 1\]'),
    (['lanes', 0, 'class_limits'], {'car': 80}, r'lanes\[0\].class_limits.car: found 80'),
    (['lanes', 0, 'speed_limit'], 55, r'lanes\[0\].speed_limit: found 55'),
])
def test_site_faults(write, place, value, match, put):
    """Each fault names the file, the place, what was found and what was wanted."""
    path = write(put(SITE, place, value))
    with pytest.raises(SiteError, match=f'file.yaml: .*{match}') as info:
        load_site(path)
    assert '\n' not in str(info.value) and 'wanted' in str(info.value)


def test_lines_found_in_images_may_cross_between_their_points(write, put):
    """In a bend, if one has few points; for clicked lines that would be a mistake."""
    crossing = put(SITE, ['lines', 'b', 'left_image'], [[180, 300], [150, 420], [130, 500]])
    for view in ('left', 'right'):
        count = len(crossing['lines']['b'][f'{view}_image'])
        crossing = put(crossing, ['lines', 'b', f'{view}_std_px'], [0.5] * count)
    assert len(load_site(write(crossing)).lines) == len(SITE['lines'])


@pytest.mark.parametrize('text, match', [
    ('[1, 2', 'readable YAML'), ('', 'found nothing, wanted a mapping'), ('[]', 'found a list'),
    ('stereo_speed_site: 1\nname: a\nname: b\n', "key 'name' given twice"),
    ('? [a]\n: 1\n', 'readable YAML'), ('a: &x [*x', 'readable YAML')])
def test_files_that_are_no_site(write, text, match):
    """Broken YAML is one clear line as well."""
    with pytest.raises(SiteError, match=match) as info:
        load_site(write(text))
    assert '\n' not in str(info.value)


def test_missing_and_binary_files(tmp_path):
    """A missing file and a binary file."""
    with pytest.raises(SiteError, match='none.yaml: file: found .*No such file'):
        load_site(tmp_path / 'none.yaml')
    (tmp_path / 'x.yaml').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(SiteError, match='wanted readable YAML'):
        load_site(tmp_path / 'x.yaml')


def test_tolerances_of_the_rig_are_read_with_the_site(tmp_path):
    path = tmp_path / 'site.yaml'
    text = Path(SAMPLE_SITE).read_text()
    path.write_text(text + 'tolerances: {focal_std: 0.001, stamp_std_s: 0.0005}\n')
    site = load_site(path)
    assert dict(site.tolerances) == {'focal_std': 0.001, 'stamp_std_s': 0.0005}
    path.write_text(site_text(site))
    assert dict(load_site(path).tolerances) == dict(site.tolerances)
    path.write_text(text + 'tolerances: {focal_std: -1}\n')
    with pytest.raises(InputError, match=r'site.yaml: tolerances.focal_std: found -1'):
        load_site(path)
    path.write_text(text + 'tolerances: {focus: 1}\n')
    with pytest.raises(InputError, match='unknown key focus'):
        load_site(path)
