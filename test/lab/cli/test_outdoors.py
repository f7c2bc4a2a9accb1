# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies, light and camera faults as options of ``accuracy`` and ``simulate``."""
from __future__ import annotations

import csv

import pytest
from stereo_speed.cli import main as cli
from stereo_speed.io.bags import StereoBag


@pytest.mark.slow
def test_accuracy_tabulates_fixed_options(tmp_path, capsys):
    assert cli.main(['accuracy', '--passes', '1', '--lines', 'exact', '--jobs', '0', '--detect',
                     '--out', str(tmp_path), '--outdoors', 'vehicle=van', 'lamps=clipping',
                     'light=overcast', 'fault=none']) == 0
    rows = capsys.readouterr().out.splitlines()
    for name in ('vehicle: van', 'lamps: clipping', 'light: overcast', 'fault: none'):
        assert any(row.startswith(f'| {name} | 1 |') for row in rows)
    assert 'classes of vehicles: 1 right, 0 unknown, 0 wrong' in rows
    with (tmp_path / 'passes.csv').open() as file:
        found, = csv.DictReader(file)
    assert (found['vehicle'], found['fault'], found['class']) == ('van', 'none', 'van')


@pytest.mark.slow
def test_outdoor_body_is_written(tmp_path):
    assert cli.main(['simulate', '--out', str(tmp_path / 'bus'), '--kind', 'bus', '--lamp-grey',
                     '3000', '--gloss', '0.5', '--light', 'wet_night', '--lens', '0.6', '0.03',
                     '8', '--exposure-step', '0.15', '--right-gain', '1.1', '--right-defocus',
                     '1', '--dirt', '5', '--pairs', '2']) == 0
    with StereoBag(tmp_path / 'bus' / 'bag') as bag:
        pairs = list(bag.pairs())
    assert len(pairs) == 2
    assert pairs[0].left.max() == 255 and pairs[0].left.mean() < 60


@pytest.mark.parametrize('words, said', [
    (['accuracy', '--outdoors', 'vehicle'], '--outdoors: found vehicle, wanted HEADING=KIND'),
    (['accuracy', '--outdoors', 'vehicle=tank'], '--outdoors vehicle: found tank'),
    (['simulate', '--out', 'x', '--gloss', '1'], '--gloss: found 1.0, wanted a --kind'),
    (['simulate', '--out', 'x', '--kind', 'tank'], '--kind')])
def test_bad_options_are_one_line(words, said, capsys):
    assert cli.main(words) == 2
    err = capsys.readouterr().err
    assert said in err and err.count('\n') == 1
