# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The commands evaluate and accuracy, from the command line to their files."""
from __future__ import annotations

import csv
from pathlib import Path

import pytest
from stereo_speed.cli.main import main

SAMPLE = Path(__file__).resolve().parents[3] / 'sample' / 'straight55'
PNG = b'\x89PNG'


def rows_of(path):
    """Read a table."""
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_small_version_of_the_papers_tables(tmp_path, capsys):
    args = ['evaluate', '--paper', '--quick', '--trackers', 'constrained', '--lines', 'picked',
            '--jobs', '2', '--out', str(tmp_path)]
    assert main(args) == 0
    first = capsys.readouterr()
    assert 'failed' not in first.err
    assert first.out.count('- yes: Table') == 8 + ('- yes: Table I(a), 400: 20' in first.out) \
        + ('- yes: Table II(a), 400: 20' in first.out)  # the times are the machine's
    for name, values in (('Ia', ['100', '400']), ('Ib', ['4', '10']), ('IIa', ['100', '400']),
                         ('IIb', ['0.05', '0.15'])):
        rows = rows_of(tmp_path / f'table_{name}.csv')
        assert [next(iter(row.values())) for row in rows] == values
        for row in rows:
            assert float(row['ours, last reading']) <= 0.5 * float(row['max error, mph: paper'])
    for name in ('speed_straight55.png', 'error_particles.png'):
        assert (tmp_path / name).read_bytes().startswith(PNG)
    assert first.out.split('in /')[0].strip() == (tmp_path / 'evaluation.md').read_text().strip()
    # again: nothing is run, all is printed the same
    journal = (tmp_path / 'runs.jsonl').read_text()
    assert main(args) == 0
    assert (tmp_path / 'runs.jsonl').read_text() == journal
    assert capsys.readouterr().out == first.out


@pytest.mark.slow
def test_bag_with_truth_and_several_numbers_of_particles(tmp_path, capsys):
    assert main(['evaluate', str(SAMPLE), '--trackers', 'constrained', '--seeds', '2',
                 '--particles', '100', '200', '--jobs', '0', '--out', str(tmp_path)]) == 0
    assert 'constrained, N = 200' in capsys.readouterr().out
    rows = rows_of(tmp_path / '0_straight55.csv')
    assert [row['tracker'] for row in rows] == ['constrained, N = 100', 'constrained, N = 200']
    for row in rows:
        assert float(row['truth, mph']) == pytest.approx(55.0, abs=0.01)
        assert row['lost'] == '0/2'
        assert float(row['pass max, mph']) < 1.0
    assert (tmp_path / 'error_0_straight55.png').read_bytes().startswith(PNG)


@pytest.mark.slow
def test_accuracy_writes_its_tables(tmp_path, capsys):
    assert main(['accuracy', '--passes', '2', '--picked', '--particles', '100', '--jobs', '0',
                 '--out', str(tmp_path)]) == 0
    assert 'measured, more than 0.1 mph and 2 σ off: ' in capsys.readouterr().out
    passes = rows_of(tmp_path / 'passes.csv')
    assert [row['path'] for row in passes] == ['straight', 'circle']
    assert rows_of(tmp_path / 'accuracy.csv')[0]['passes'] == '2'
    assert '| path: circle | 1 |' in (tmp_path / 'accuracy.md').read_text()


@pytest.mark.parametrize(('args', 'wanted'), [
    (['evaluate', '--out', '{}'], 'no sequence'),
    (['evaluate', '--paper'], '--out'),
    (['evaluate', '--paper', '--particles', '100', '--out', '{}'], 'either one'),
    (['evaluate', '--sequences', 'moon', '--out', '{}'], 'moon'),
    (['evaluate', '--paper', '--trackers', 'luck', '--out', '{}'], 'luck'),
    (['evaluate', '--paper', '--seeds', '0', '--out', '{}'], '--seeds'),
    (['evaluate', '{}', '--out', '{}'], '--site'),
    (['evaluate', str(SAMPLE), '--truth', '{}/no.csv', '--out', '{}'], 'no.csv'),
    (['evaluate', str(SAMPLE), str(SAMPLE), '--truth', 'a', '--out', '{}'], 'one bag'),
    (['accuracy', '--passes', '0'], '--passes'),
    (['accuracy', '--particles', '3'], 'particles'),
    (['accuracy', '--refine', '--picked'], 'not allowed')])
def test_bad_arguments_are_one_line(args, wanted, tmp_path, capsys):
    assert main([arg.format(tmp_path) for arg in args]) == 2
    err = capsys.readouterr().err
    assert err.startswith('error: ')
    assert err.count('\n') == 1
    assert wanted in err
