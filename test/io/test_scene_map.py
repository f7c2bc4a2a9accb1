# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Maps and their polygons: round trip, and bad files."""
import cv2
import numpy as np
import pytest

from stereo_speed.core.errors import InputError, SiteError
from stereo_speed.io.scene_map import check_map_size, load_map, load_regions
from stereo_speed.monocular.regions import draw_map


def test_map_round_trip(tmp_path):
    labels = np.random.default_rng(0).choice(np.array([0, 128, 255], np.uint8), (20, 30))
    for name in ('map.png', 'map ü.bmp'):
        (tmp_path / name).write_bytes(cv2.imencode(name[-4:], labels)[1].tobytes())
        np.testing.assert_array_equal(load_map(tmp_path / name), labels)


def test_invalid_maps_are_refused(tmp_path):
    path = tmp_path / 'map.png'
    with pytest.raises(InputError, match=r'map\.png: map: found No such file'):
        load_map(path)
    grey = np.full((4, 5), 128, np.uint8)
    for image, told in (
            (grey + 1, r'grey levels \[129\]'),
            (np.arange(20, dtype=np.uint8).reshape(4, 5), r'grey levels \[1, 2, 3, 4, 5\]'),
            (np.repeat(grey[..., None], 3, -1), r'uint8 of shape \(4, 5, 3\)'),
            (grey.astype(np.uint16) * 257, r'uint16 of shape \(4, 5\)')):
        cv2.imwrite(str(path), image)
        with pytest.raises(InputError, match=rf'map\.png: map: found {told}, wanted an 8-bit gre'):
            load_map(path)
    for junk in (b'', b'junk', b'\x89PNG\r\n'):
        path.write_bytes(junk)
        with pytest.raises(InputError, match=f'found {len(junk)} bytes that cannot be decoded'):
            load_map(path)


REGIONS = """stereo_speed_map: 1
background: inaccessible
regions:
- {kind: accessible, polygon: [[0, 0], [30.5, 0], [30.5, 9.5], [0, 9.5]]}
- {kind: pathway, polygon: [[-5, 2], [40, 2], [40, 6.5]]}
"""


def test_regions(written):
    regions, background = load_regions(written(REGIONS))
    assert background == 'inaccessible'
    assert [r.kind for r in regions] == ['accessible', 'pathway']
    np.testing.assert_array_equal(regions[1].polygon_px, [[-5, 2], [40, 2], [40, 6.5]])
    labels = draw_map(regions, 40, 12, background)
    assert (labels[0, 0], labels[3, 20], labels[11, 5], labels[0, 35]) == (128, 255, 0, 0)
    text = REGIONS.replace('background: inaccessible\n', '')
    assert load_regions(written(text))[1] == 'accessible'


@pytest.mark.parametrize(('old', 'new', 'told'), [
    ('stereo_speed_map: 1', 'stereo_speed_map: true', 'stereo_speed_map: found True, wanted 1'),
    ('background: inaccessible', 'background: lawn',
     "background: found 'lawn', wanted pathway, accessible, inaccessible"),
    ('kind: pathway', 'kind: road', r"regions\[1\]\.kind: found 'road', wanted pathway, acc"),
    ('kind: pathway, ', '', r'regions\[1\]\.kind: found nothing'),
    ('[-5, 2], ', '', r'regions\[1\]\.polygon'),
    ('[-5, 2]', '[-5]', r'regions\[1\]\.polygon'),
    ('[-5, 2]', '[-5, .inf]', r'regions\[1\]\.polygon'),
    ('kind: pathway', 'name: a, kind: pathway', r'regions\[1\]\.name'),
    ('regions:', 'areas:', 'areas'),
], ids=str)
def test_invalid_regions_are_refused(written, old, new, told):
    assert old in REGIONS
    path = written(REGIONS.replace(old, new, 1))
    with pytest.raises(SiteError, match=told) as raised:
        load_regions(path)
    assert str(raised.value).startswith(f'{path}: ') and '\n' not in str(raised.value)


def test_map_of_another_size_than_the_frames():
    labels = np.full((20, 30), 128, np.uint8)
    check_map_size(labels, np.zeros((20, 30, 3), np.uint8), 'map.png')
    with pytest.raises(InputError, match=r'map\.png: size of the map: found 30x20 px, '
                                         r'wanted 20x30 px as the frames'):
        check_map_size(labels, np.zeros((30, 20, 3), np.uint8), 'map.png')
