# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The ``traffic`` command: results, files, refusals."""
from __future__ import annotations

import csv
import itertools
import json

import pytest

from stereo_speed.cli import main as cli


@pytest.mark.slow
def test_short_stream_is_measured(tmp_path, capsys):
    """15 s of the traffic in the docs' table: each vehicle once, no wrong or false ones."""
    assert cli.main(['traffic', '--minutes', '0.25', '--vehicles', '5', '--fps', '5', '--lanes',
                     '2', '--lines', 'exact', '--particles', '200', '--seed', '1', '--out',
                     str(tmp_path)]) == 0
    names, cells = ([cell.strip() for cell in line.split('|')]
                    for line in itertools.compress(
                        capsys.readouterr().out.splitlines(), (1, 0, 1)))
    row = dict(zip(names, cells))
    assert int(row['vehicles']) >= 3 and row['measured once'] == row['vehicles']
    assert row['false tracks'] == row['wrong by > 1 mph'] == '0'
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert summary['score']['once'] == int(row['vehicles'])
    assert (summary['traffic']['lines'], summary['timings']['pairs']) == ('exact', 75)
    with (tmp_path / 'passes.csv').open() as file:
        assert len(list(csv.DictReader(file))) == summary['score']['once']


@pytest.mark.parametrize('words, said', [
    (['--lanes', '2', '--receding', '2'], '--receding: found 2, wanted fewer than 2'),
    (['--light', 'noon'], '--light'), (['--minutes', '0'], '--minutes'),
    (['--particles', '1'], 'particles'), (['--lane-changes', '0'], '--lane-changes'),
    (['--out', 'a', '--bag', 'b'], 'not allowed')])
def test_bad_options_are_one_line(words, said, capsys):
    assert cli.main(['traffic', *words]) == 2
    err = capsys.readouterr().err
    assert said in err and err.count('\n') == 1
