# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``stats`` and ``verify-against`` over runs of ``replay``."""
from __future__ import annotations

import csv
import json
import sqlite3

import pytest
from stereo_speed.cli.main import main
from stereo_speed.core.passes import Direction, PassResult, Verdict
from stereo_speed.core.units import KMH_MPS
from stereo_speed.io.results import write_run

S = 10 ** 9


def result(track, kmh, lane='near'):
    mps = None if kmh is None else kmh * KMH_MPS
    return PassResult(track, lane, 100 * track * S, (100 * track + 2) * S, 9, mps,
                      None if mps is None else 0.1,
                      Verdict.REJECTED if mps is None else Verdict.MEASURED,
                      'uncertain' if mps is None else '', {}, {}, direction=Direction.RECEDING)


@pytest.fixture()
def runs(tmp_path):
    """Write two runs below one folder, and return it."""
    lanes = {'near': {'speed_limit_mps': 60 * KMH_MPS}, '<far>': {'speed_limit_mps': None}}
    write_run(tmp_path / 'runs' / 'a', [], [result(1, 50), result(2, 70), result(3, None)],
              {'lanes': lanes})
    write_run(tmp_path / 'runs' / 'b', [], [result(4, 90, '<far>')], {'lanes': lanes})
    return tmp_path / 'runs'


def test_stats_as_csv_and_report(runs, tmp_path, capsys):
    out = tmp_path / 'out'
    assert main(['stats', str(runs), '--out', str(out), '--units', 'km/h']) == 0
    with (out / 'stats.csv').open(newline='') as file:
        rows = {(row['by'], row['name']): row for row in csv.DictReader(file)}
    assert rows['all', 'all']['passes'] == '4' and rows['all', 'all']['measured'] == '3'
    assert float(rows['all', 'all']['mean_mps']) == pytest.approx(70 * KMH_MPS, abs=1e-5)
    assert float(rows['lane', 'near']['over_share']) == 0.5
    assert rows['lane', '<far>']['over_share'] == ''
    assert ('direction', 'receding') in rows
    page = (out / 'stats.html').read_text()
    assert 'lane &lt;far&gt;' in page and '<far>' not in page
    assert 'http' not in page.replace('http-equiv', '')  # nothing is loaded
    assert '70.0' in capsys.readouterr().out


@pytest.mark.parametrize('form', ['parquet', 'sqlite'])
def test_stats_in_other_forms(runs, tmp_path, form):
    out = tmp_path / 'out'
    assert main(['stats', str(runs / 'a'), str(runs / 'b'), '--out', str(out)]) == 0
    assert main(['stats', str(runs), '--out', str(out), '--format', form]) == 0
    assert not (out / 'stats.csv').exists()  # an older table in another format is removed
    path = out / f'stats.{form}'
    if form == 'parquet':
        parquet = pytest.importorskip('pyarrow.parquet')
        rows = [(r['by'], r['name'], r['passes'], r['mean_mps'])
                for r in parquet.read_table(path).to_pylist()]
    else:
        rows = sqlite3.connect(path).execute(
            'SELECT by, name, passes, mean_mps FROM stats').fetchall()
    assert rows[0][:3] == ('all', 'all', 4)
    assert rows[0][3] == pytest.approx(70 * KMH_MPS)


def test_verification(runs, tmp_path, capsys):
    path, out = tmp_path / 'reference.csv', tmp_path / 'out'
    path.write_text('time_ns,lane,speed_mps,std_mps\n'
                    f'{101 * S},near,{50.5 * KMH_MPS},0.1\n{201 * S},near,{74 * KMH_MPS},0.1\n'
                    f'{301 * S},near,{60 * KMH_MPS},0.1\n{801 * S},near,20,0.1\n')
    assert main(['verify-against', str(path), '--passes', str(runs), '--out', str(out)]) == 0
    figures = json.loads((out / 'verification.json').read_text())
    assert (figures['counted'], figures['within'], figures['rejected'], figures['no_pass']) == (
        2, 1, 1, 1)
    assert figures['passes_wanted']['99.8 % reliable']['wanted'] > 1497  # one has failed
    with (out / 'verification.csv').open(newline='') as file:
        assert [row['outcome'] for row in csv.DictReader(file)] == [
            'measured', 'measured', 'uncertain', 'no_pass']
    assert 'NOT within' in (out / 'verification.html').read_text()
    assert 'approval: 500 passes needed, 498 of them missing' in capsys.readouterr().out


@pytest.mark.parametrize(('text', 'said'), [
    ('time_ns,lane,speed_mps\n1,near,20\n', 'std_mps'),
    ('time_ns,lane,speed_mps,std_mps\n', 'rows: found none'),
    ('time_ns,lane,speed_mps,std_mps\n1,near,fast,0.1\n', 'line 2, speed_mps'),
    ('time_ns,lane,speed_mps,std_mps\n1.5,near,20,0.1\n', 'line 2, time_ns'),
    ('time_ns,lane,speed_mps,std_mps\n1,near,20,0\n', 'line 2: found speed_mps 20, std_mps 0'),
    ('time_ns,lane,speed_mps,std_mps\n1,,20,0.1\n', 'line 2, lane')])
def test_unusable_references_are_one_line(runs, tmp_path, capsys, text, said):
    path = tmp_path / 'reference.csv'
    path.write_text(text)
    assert main(['verify-against', str(path), '--passes', str(runs),
                 '--out', str(tmp_path / 'out')]) == 2
    error = capsys.readouterr().err
    assert error.count('\n') == 1 and said in error
    assert not (tmp_path / 'out').exists()


def test_places_without_passes_are_one_line(tmp_path, capsys):
    (tmp_path / 'empty.sqlite').write_bytes(b'no database, but long enough to look at' * 9)
    for place in (tmp_path, tmp_path / 'empty.sqlite'):
        assert main(['stats', str(place), '--out', str(tmp_path / 'out')]) == 2
        error = capsys.readouterr().err
        assert error.count('\n') == 1 and str(place) in error
