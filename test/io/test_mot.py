# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Files of the monocular tracker: there and back, to the letter, and what is wrong with them."""
import json
import math
import re

import cv2
import numpy as np
import pytest

from stereo_speed.core.config import load_config
from stereo_speed.core.errors import InputError, SiteError
from stereo_speed.io.mot import (
    boxes_text, check_targets, ends_text, load_map, load_regions, load_targets, load_truth,
    targets_text, write_targets)
from stereo_speed.monocular.boxes import Target, TargetEnd, TargetEstimate, TargetState
from stereo_speed.monocular.config import MonocularConfig
from stereo_speed.monocular.regions import draw_map

TARGETS = """environment_targets: 1
targets:
- {id: 4, frame: 12, box: [10.5, 20, 30, 40.25]}
- {id: 0, frame: 1, box: [-5, 2, 8, 9], angle_deg: -30}
"""


def written(tmp_path, text, name='file.yaml'):
    path = tmp_path / name
    path.write_text(text, encoding='utf-8')
    return path


def estimate(frame, number=1, box=(1, 2, 3, 4), angle_rad=0.0, **changes):
    fields = {'state': TargetState.TRACKED, 'distance_px': -2.5, 'distance_rate_px': -0.0001,
              'similarity': 0.875, 'velocity_px': np.zeros(2), **changes}
    return TargetEstimate(frame=frame, id=number, box_px=np.array(box, dtype=float),
                          angle_rad=angle_rad, **fields)


def test_targets(tmp_path):
    first, second = load_targets(written(tmp_path, TARGETS))
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
    ('id: 4', 'id: 0', r'targets\[1\]\.id: found 0 again, wanted an id of its own'),
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
def test_targets_that_are_wrong(tmp_path, old, new, told):
    assert old in TARGETS
    path = written(tmp_path, TARGETS.replace(old, new, 1))
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


def test_map_there_and_back(tmp_path):
    labels = np.random.default_rng(0).choice(np.array([0, 128, 255], np.uint8), (20, 30))
    for name in ('map.png', 'map ü.bmp'):
        (tmp_path / name).write_bytes(cv2.imencode(name[-4:], labels)[1].tobytes())
        np.testing.assert_array_equal(load_map(tmp_path / name), labels)


def test_maps_that_are_wrong(tmp_path):
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
        with pytest.raises(InputError, match=f'found {len(junk)} bytes that are no image'):
            load_map(path)


REGIONS = """stereo_speed_map: 1
background: inaccessible
regions:
- {kind: accessible, polygon: [[0, 0], [30.5, 0], [30.5, 9.5], [0, 9.5]]}
- {kind: pathway, polygon: [[-5, 2], [40, 2], [40, 6.5]]}
"""


def test_regions(tmp_path):
    regions, background = load_regions(written(tmp_path, REGIONS))
    assert background == 'inaccessible'
    assert [r.kind for r in regions] == ['accessible', 'pathway']
    np.testing.assert_array_equal(regions[1].polygon_px, [[-5, 2], [40, 2], [40, 6.5]])
    labels = draw_map(regions, 40, 12, background)
    assert (labels[0, 0], labels[3, 20], labels[11, 5], labels[0, 35]) == (128, 255, 0, 0)
    text = REGIONS.replace('background: inaccessible\n', '')
    assert load_regions(written(tmp_path, text))[1] == 'accessible'


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
def test_regions_that_are_wrong(tmp_path, old, new, told):
    assert old in REGIONS
    path = written(tmp_path, REGIONS.replace(old, new, 1))
    with pytest.raises(SiteError, match=told) as raised:
        load_regions(path)
    assert str(raised.value).startswith(f'{path}: ') and '\n' not in str(raised.value)


def test_boxes_to_the_letter():
    turned = estimate(2, 7, (10, 20, 8, 4), math.pi / 2)
    assert boxes_text([turned, estimate(2, 1), estimate(1, 7)]) == (
        '1,7,1.000,2.000,3.000,4.000,0.875,-1,-1,-1\n'
        '2,1,1.000,2.000,3.000,4.000,0.875,-1,-1,-1\n'
        '2,7,12.000,18.000,4.000,8.000,0.875,-1,-1,-1\n')  # the upright box around it


def test_boxes_there_and_back(tmp_path):
    rng = np.random.default_rng(0)
    estimates = [estimate(frame, number, rng.uniform(1, 700, 4), similarity=rng.uniform(0.1, 1))
                 for frame in range(1, 30, 3) for number in (2, 5)]
    found = load_truth(written(tmp_path, boxes_text(estimates), 'boxes.txt'))
    assert sorted(found) == [2, 5] and sorted(found[2]) == list(range(1, 30, 3))
    for e in estimates:
        np.testing.assert_allclose(found[e.id][e.frame], e.box_px, atol=6e-4)


def test_truth_of_the_motchallenge(tmp_path):
    path = written(tmp_path, '3,1,912,484,97,109,0,7,1\n\n2,1,1,2,3,4,1,1,1\n2,-7,1.5,2,3,4\n'
                   '3,2,5,6,7,8,-1,-1,-1,-1\n', 'gt.txt')
    found = load_truth(path)
    assert {k: sorted(v) for k, v in found.items()} == {1: [2], -7: [2], 2: [3]}
    np.testing.assert_array_equal(found[-7][2], [1.5, 2, 3, 4])


@pytest.mark.parametrize('line', [
    '1,1,2,3,4', '0,1,2,3,4,5', '1.5,1,2,3,4,5', '1,1.5,2,3,4,5', '1,1,2,3,0,5', '1,1,2,3,4,-5',
    '1,1,nan,3,4,5', '1,1,2,inf,4,5', 'frame,id,x,y,w,h', '1;1;2;3;4;5', '1,1,2,3,,5'])
def test_truth_that_is_wrong(tmp_path, line):
    path = written(tmp_path, f'1,1,2,3,4,5\n{line}\n', 'gt.txt')
    with pytest.raises(InputError, match=f'^{re.escape(str(path))}: line 2: found '
                                         f'{re.escape(repr(line))}, wanted frame,id,x,y,w,h'):
        load_truth(path)


def test_truth_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r'gt\.txt: file: found .*No such file'):
        load_truth(tmp_path / 'gt.txt')
    (tmp_path / 'gt.txt').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(InputError, match=r'gt\.txt: file: found .*decode'):
        load_truth(tmp_path / 'gt.txt')
    for text in ('', '1,1,2,3,4,5,0\n'):
        with pytest.raises(InputError, match=r'gt\.txt: boxes: found none'):
            load_truth(written(tmp_path, text, 'gt.txt'))


def test_targets_csv_to_the_letter():
    text = targets_text([estimate(3, distance_px=math.inf), estimate(2, angle_rad=math.pi / 6)])
    assert text == ('frame,id,x,y,w,h,angle_deg,d_px,d_rate_px\n'
                    '2,1,1.000,2.000,3.000,4.000,30.000,-2.500,0.000\n'
                    '3,1,1.000,2.000,3.000,4.000,0.000,inf,0.000\n')


def test_ends_to_the_letter():
    ends = [TargetEnd(id=9, first_frame=2, last_frame=8, frames=3, state=TargetState.LOST),
            TargetEnd(id=1, first_frame=1, last_frame=5, frames=5, state=TargetState.LEFT_VIEW)]
    assert ends_text(ends) == ('id,first_frame,last_frame,frames,end\n1,1,5,5,left_view\n'
                               '9,2,8,3,lost\n')


def test_folder_of_a_run(tmp_path):
    out = tmp_path / 'out'
    out.mkdir()
    (out / 'summary.json').write_text('old')
    (out / 'annotated.avi').write_text('of an older run')
    (out / 'photo.png').write_text('mine')
    end = TargetEnd(id=1, first_frame=1, last_frame=2, frames=2, state=TargetState.STREAM_ENDED)
    write_targets(out, [estimate(2), estimate(1)], [end], {'seed': 3})
    assert sorted(p.name for p in out.iterdir()) == [
        'boxes.txt', 'ends.csv', 'photo.png', 'summary.json', 'targets.csv']
    assert (out / 'boxes.txt').read_text() == boxes_text([estimate(1), estimate(2)])
    assert (out / 'targets.csv').read_text() == targets_text([estimate(1), estimate(2)])
    assert (out / 'ends.csv').read_text() == ends_text([end])
    assert json.loads((out / 'summary.json').read_text())['seed'] == 3
    (tmp_path / 'video').write_text('of this run')
    write_targets(out, [estimate(2)], [end], {'seed': 4}, tmp_path / 'video')
    assert (out / 'annotated.avi').read_text() == 'of this run'
    assert not (tmp_path / 'video').exists()
    with pytest.raises(InputError, match='photo.png: output folder'):
        write_targets(out / 'photo.png', [], [], {})


def test_config_there_and_back(tmp_path):
    assert load_config(written(tmp_path, '{}'), MonocularConfig) == MonocularConfig()
    found = load_config(
        written(tmp_path, 'particles: 300\nprior_noise: 0.1\n'), MonocularConfig)
    assert found == MonocularConfig(particles=300, prior_noise=0.1)
    for text, told in (('particles: 5', 'particles: found 5'), ('lambda_c: 1', 'key: found lamb'),
                       ('- 1', 'top level: found list'), ('a: [', 'file: found'),
                       ('prior_noise: .nan', 'prior_noise'), ('particles: many', 'particles')):
        with pytest.raises(InputError, match=rf'file\.yaml: {told}'):
            load_config(written(tmp_path, text), MonocularConfig)
