# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Runs under review: read from the files of ``replay``."""
from __future__ import annotations

from contextlib import closing
import shutil
import sqlite3

import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.passes import Direction, PassResult, SecondEstimate, SpeedBudget, Verdict
from stereo_speed.io.pass_json import pass_text
from stereo_speed.io.pass_log import PassLog
from stereo_speed.io.pass_tables import write_pass_tables
from stereo_speed.io.results import kind_of, PASS_COLUMNS
from stereo_speed.studio import pass_logs
from stereo_speed.studio.opening import open_runs
from stereo_speed.studio.runs import RunFolder


def test_run_is_read(tmp_path, make_run):
    run, = open_runs([make_run(tmp_path / 'run')])
    assert run.overview() == {'name': 'run', 'kind': 'folder', 'passes': 3, 'measured': 3}
    assert run.passes[1]['speed_mps'] == pytest.approx(20.05)
    assert run.rows()[2] == {'key': 2, **run.passes[2]}
    assert run.passes[0]['first_ns'] == 10**18  # exact, no float
    assert [row['track'] for row in run.at(10**18 + 10**9)] == [1]
    assert len(run.opened(2).rows) == 2 and run.opened(9) is None
    assert run.bag_hash == 'abc'


def test_every_column_of_a_pass_is_read(tmp_path, make_run):
    run, = open_runs([make_run(
        tmp_path / 'run', direction=Direction.APPROACHING, second=SecondEstimate(20.01, 0.25, 7),
        budget=SpeedBudget(0.01, 0.02, 0.03, 0.04))])
    row = run.passes[0]
    assert tuple(row) == PASS_COLUMNS
    assert row['direction'] == 'approaching' and row['second_mps'] == 20.01
    assert {key: type(value) for key, value in row.items() if value is not None} == {
        key: kind_of(key) for key, value in row.items() if value is not None}


def test_table_has_the_digits_of_the_folder_and_no_formulas(tmp_path, make_run):
    run, = open_runs([make_run(tmp_path / 'run', lane='=1+1')])
    head, *lines = (tmp_path / 'run' / 'passes.csv').read_text().splitlines()
    assert run.table([2, 0]).splitlines() == [
        head, *(lines[key].replace('=1+1', "'=1+1") for key in (2, 0))]
    with pytest.raises(InputError, match='keys: found 3'):
        run.table([3])


def test_folder_of_runs(tmp_path, make_run):
    many = tmp_path / 'many'
    runs = {name: make_run(many / name) for name in ('b', 'a')}
    assert [run.name for run in open_runs([many])] == ['many/a', 'many/b']
    write_pass_tables(many, runs, {})
    everything, *_ = open_runs([many])
    assert everything.name == 'many/passes.sqlite'
    assert [(row['bag'], row['track']) for row in everything.rows()] == [
        (bag, track) for bag in 'ab' for track in range(3)]
    assert everything.overview()['measured'] == 6
    assert everything.opened(1).rows == []


@pytest.mark.slow
def test_database_agrees_with_the_folder(replayed):
    folder, _ = open_runs([replayed])
    log, = open_runs([replayed / 'run.sqlite'])
    assert log.overview() == {'name': 'run.sqlite', 'kind': 'log', 'passes': 1, 'measured': 1}
    (passed,), (logged,) = folder.rows(), log.rows()
    opened = log.opened(logged['key'])
    for name, value in passed.items():
        if name != 'key':
            found = {**opened.more, **logged}[name]
            assert found == (pytest.approx(value, abs=1e-5) if type(value) is float else value)
    rows = folder.opened(0).rows
    assert [row['stamp_ns'] for row in opened.rows] == [row['stamp_ns'] for row in rows]
    for one, other in zip(opened.rows, rows):
        for name in ('x_m', 'y_m', 'z_m'):
            assert one[name] == pytest.approx(other[name], abs=1e-5)
        assert (one['speed_mps'] is None) == (other['state'] != 'confirmed')
    assert log.table([logged['key']]).count('\n') == 2
    assert log.opened(99) is None


def test_newest_passes_of_a_long_log_are_shown(tmp_path, monkeypatch):
    monkeypatch.setattr(pass_logs, 'MOST_PASSES', 2)
    with PassLog(tmp_path / 'log.sqlite') as writer:
        for track in range(5):
            writer.add_pass(pass_text('r', PassResult(
                track, 'near', 10, 20, 5, 24.5, 0.1, Verdict.MEASURED, '', {}, {})))
    log, = open_runs([tmp_path / 'log.sqlite'])
    assert [row['track'] for row in log.rows()] == [3, 4]
    assert log.overview()['passes'] == 5


def test_log_shows_passes_written_meanwhile(tmp_path):
    path = tmp_path / 'log.sqlite'
    result = PassResult(3, 'near', 10, 20, 5, 24.5, 0.1, Verdict.MEASURED, '', {}, {})
    with PassLog(path) as writer:
        log, = open_runs([path])
        assert log.rows() == []
        for name in ('r', 'again'):  # one bag, measured in two runs of the instrument
            writer.add_pass(pass_text(name, result))
            for stamp_ns in (10, 20):
                writer.add_track(stamp_ns, 'vehicle_3', 24.4, 0.2, (1.0, 2.0, 30.0))
        writer.keep()
        assert [row['run'] for row in log.rows()] == ['r', 'again']
        assert [row['stamp_ns'] for row in log.opened(2).rows] == [10, 20]


@pytest.mark.parametrize(('make', 'told'), [
    ('CREATE TABLE other (a)', 'wanted an SQLite file with a table passes'),
    ('CREATE TABLE passes (track)', 'columns: found no lane, first_ns'),
])
def test_other_database_is_one_line(tmp_path, make, told):
    with closing(sqlite3.connect(tmp_path / 'some.db')) as database:
        database.execute(make)
    with pytest.raises(InputError, match=told):
        open_runs([tmp_path / 'some.db'])
    (tmp_path / 'text.db').write_text('no database at all, but a text of some length')
    with pytest.raises(InputError, match='text.db: database: found file is not a database'):
        open_runs([tmp_path / 'text.db'])


@pytest.mark.slow
def test_cell_of_another_type_is_one_line(replayed, tmp_path):
    path = tmp_path / 'log.sqlite'
    shutil.copy(replayed / 'run.sqlite', path)
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE passes SET speed_mps = 'fast'")
    log, = open_runs([path])
    with pytest.raises(InputError, match="passes, speed_mps: found 'fast', wanted a number"):
        log.rows()


def test_only_plots_are_pictures_of_a_run(tmp_path, make_run):
    folder = make_run(tmp_path / 'run')
    (folder / 'speed.png').write_bytes(b'png')
    (folder / 'secret.png').write_bytes(b'png')
    run = RunFolder.read(folder, 'run')
    assert run.plots == ['speed.png']
    assert run.plot('secret.png') is None and run.plot('../run/speed.png') is None


@pytest.mark.parametrize(('damage', 'told'), [
    (lambda f: (f / 'tracks.csv').unlink(), 'tracks.csv: found no such file'),
    (lambda f: (f / 'summary.json').write_text('{'), 'summary.json: file: .* wanted JSON'),
    (lambda f: (f / 'summary.json').write_text('[]'), 'wanted a JSON object'),
    (lambda f: (f / 'passes.csv').write_text('track\n1\n'), 'passes.csv: columns: found no lane'),
    (lambda f: (f / 'passes.csv').write_text(
        (f / 'passes.csv').read_text().replace('20.00000', 'fast')),
     "line 2, speed_mps: found 'fast', wanted a number"),
    (lambda f: (f / 'passes.csv').write_text((f / 'passes.csv').read_text() + '7,lane\n'),
     'line 5: found another number of cells'),
    (lambda f: (f / 'tracks.csv').write_bytes(b'\xff\xfe'), 'text in UTF-8'),
])
def test_damaged_run_is_one_line(tmp_path, make_run, damage, told):
    folder = make_run(tmp_path / 'run')
    damage(folder)
    with pytest.raises(InputError, match=told):
        open_runs([folder])


def test_no_runs(tmp_path):
    with pytest.raises(InputError, match='no such folder'):
        open_runs([tmp_path / 'none'])
    with pytest.raises(InputError, match='none, and none in its folders'):
        open_runs([tmp_path])
