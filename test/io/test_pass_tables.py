# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""One table of many runs: types, nulls, order, identical bytes when repeated."""
from __future__ import annotations

import sqlite3

from pyarrow import parquet
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.passes import PassResult, Reason, Verdict
from stereo_speed.io.pass_tables import COLUMNS, PARQUET, SQLITE, write_pass_tables
from stereo_speed.io.results import kind_of, passes_csv


def passed(track, speed_mps=20.5, **changes):
    """Return a pass."""
    fields = {'lane': 'a, b', 'first_ns': 1_700_000_000_000_000_001, 'last_ns': 2 ** 62,
              'pairs': 7, 'speed_std_mps': 0.25, 'verdict': Verdict.MEASURED, 'reason': '',
              'smoothed': {}, 'smoothed_std': {}, **changes}
    return PassResult(track=track, speed_mps=speed_mps, **fields)


@pytest.fixture
def runs(tmp_path):
    """Return two folders with passes, one without."""
    folders = {}
    rejected = passed(4).rejected(Reason.OFF_PATH)
    for name, passes in {'b': [passed(3, 21.0), rejected], 'a': [passed(3)], 'c': []}.items():
        folders[name] = tmp_path / name
        folders[name].mkdir()
        (folders[name] / 'passes.csv').write_text(passes_csv(passes))
    return folders


def test_both_tables_contain_every_pass(runs, tmp_path):
    assert write_pass_tables(tmp_path, runs, {'d': 'no bag'}) == 3
    rows = parquet.read_table(tmp_path / PARQUET).to_pylist()
    database = sqlite3.connect(tmp_path / SQLITE)
    cursor = database.execute('SELECT * FROM passes ORDER BY bag, track')
    assert tuple(c[0] for c in cursor.description) == COLUMNS
    assert [dict(zip(COLUMNS, row)) for row in cursor] == rows
    assert [(r['bag'], r['track'], r['speed_mps'], r['reason']) for r in rows] == [
        ('a', 3, 20.5, None), ('b', 3, 21.0, None), ('b', 4, None, 'off_path')]
    # A stamp is whole: as a float its last digits would be lost.
    assert rows[0]['first_ns'] == 1_700_000_000_000_000_001
    assert rows[0]['lane'] == 'a, b'
    assert database.execute('SELECT * FROM bags').fetchall() == [
        ('a', None), ('b', None), ('c', None), ('d', 'no bag')]
    database.close()


def test_same_runs_give_the_same_bytes(runs, tmp_path):
    for name in ('one', 'two'):
        write_pass_tables(tmp_path / name, runs, {})
    for name in (PARQUET, SQLITE):
        assert (tmp_path / 'one' / name).read_bytes() == (tmp_path / 'two' / name).read_bytes()


@pytest.mark.parametrize(('text', 'wanted'), [
    ('track,lane\n', 'columns'), ('', 'columns'), ('2\n', 'cells'), ('x' + ',' * 17, 'numbers')])
def test_other_table_is_refused_and_no_files_are_left(runs, tmp_path, text, wanted):
    path = runs['b'] / 'passes.csv'
    head = path.read_text().splitlines(keepends=True)[0]
    columns = len(head.split(','))
    path.write_text(text if 'columns' in wanted else head + (
        '2\n' if wanted == 'cells' else 'x' + ',' * (columns - 1) + '\n'))
    with pytest.raises(InputError, match=wanted):
        write_pass_tables(tmp_path / 'out', runs, {})
    assert list((tmp_path / 'out').iterdir()) == []


@pytest.mark.parametrize(('column', 'kind'), [
    ('first_ns', int), ('track', int), ('second_pairs', int), ('speed_mps', float),
    ('lane_to', str), ('verdict', str), ('class', str), ('class_probability', float),
    ('width_m', float)])
def test_column_name_determines_its_type(column, kind):
    assert kind_of(column) is kind
