# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Vehicles detected by another program: boxes from a file, through ``replay``."""
from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from stereo_speed.cli.main import main
from stereo_speed.core.units import MPH_MPS


def written(path, boxes):
    """Write boxes by stamp to a file."""
    with path.open('w', newline='') as file:
        rows = csv.writer(file)
        rows.writerow(['stamp_ns', 'left_px', 'top_px', 'width_px', 'height_px', 'score'])
        rows.writerows([ns, *np.round(box, 2), 0.9] for ns, box in boxes.items())
    return path


def replay(sample, out, *options):
    return main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'), '--out',
                 str(out), '--no-plots', *map(str, options)])


def test_vehicle_given_by_boxes_is_measured(sample, sample_boxes, tmp_path):
    path = written(tmp_path / 'boxes.csv', sample_boxes)
    assert replay(sample, tmp_path / 'out', '--detector', 'boxes', '--boxes', path) == 0
    one, = csv.DictReader((tmp_path / 'out' / 'passes.csv').open())
    assert one['verdict'] == 'measured'
    assert float(one['speed_mps']) / MPH_MPS == pytest.approx(
        55.0, abs=4 * float(one['speed_std_mps']) / MPH_MPS)
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['detector'] == 'boxes' and len(summary['input']['boxes_sha256']) == 64


def test_no_boxes_give_no_vehicles(sample, sample_boxes, tmp_path, capsys):
    first = min(sample_boxes)
    path = written(tmp_path / 'boxes.csv', {first: sample_boxes[first], 7: (1, 1, 2, 2)})
    assert replay(sample, tmp_path / 'out', '--detector', 'boxes', '--boxes', path) == 0
    assert (tmp_path / 'out' / 'passes.csv').read_text().count('\n') == 1
    assert '1 stamps of' in capsys.readouterr().out


@pytest.mark.parametrize(('options', 'words'), [
    (['--detector', 'boxes'], '--boxes: found nothing'),
    (['--boxes', 'BOXES'], '--boxes: found'),
    (['--detector', 'boxes', '--boxes', 'BOXES', '--init', 'INIT'], '--boxes: found'),
    (['--detector', 'boxes', '--boxes', 'NONE'], 'none.csv'),
    (['--detector', 'boxes', '--boxes', 'OTHER'], 'stamp_ns: found 3 and others'),
], ids=['nothing', 'not taken', 'annotated', 'no file', 'other stamps'])
def test_mismatched_options_are_one_line(options, words, sample, sample_boxes, tmp_path, capsys):
    paths = {'BOXES': written(tmp_path / 'boxes.csv', sample_boxes), 'NONE': tmp_path / 'none.csv',
             'OTHER': written(tmp_path / 'other.csv', {3: (1, 2, 3, 4)}),
             'INIT': sample / 'init.yaml'}
    assert replay(sample, tmp_path / 'out', *(paths.get(o, o) for o in options)) == 2
    err = capsys.readouterr().err
    assert err.startswith('error: ') and err.count('\n') == 1 and words in err
    assert not (tmp_path / 'out' / 'summary.json').exists()
