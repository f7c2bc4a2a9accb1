# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Write traffic figures as CSV, Parquet or SQLite, and verifications as CSV and JSON, in SI."""
from __future__ import annotations

from dataclasses import asdict, fields
import io
import json
from pathlib import Path
import sqlite3
import tempfile
from typing import Any, Sequence, Union

from .atomic import csv_text
from ..survey.reference import Verification
from ..survey.traffic import TrafficFigures, TrafficGroup

FORMATS = ('csv', 'parquet', 'sqlite')
Value = Union[str, int, float, None]

_COLUMNS = ('by', 'name', *(f.name for f in fields(TrafficFigures)))
_WHOLE = ('passes', 'measured', 'limited')


def traffic_file(groups: Sequence[TrafficGroup], form: str) -> tuple[str, Union[str, bytes]]:
    """
    Return name and content of a table of traffic figures.

    :param form: format, one of ``FORMATS``.
    """
    rows: list[tuple[Value, ...]] = [
        (one.by, one.group, *asdict(one.figures).values()) for one in groups]
    if form == 'csv':
        return 'stats.csv', csv_text(_COLUMNS, [
            ['' if v is None else f'{v:.5f}' if isinstance(v, float) else v for v in row]
            for row in rows])
    return (('stats.parquet', _parquet(rows)) if form == 'parquet'
            else ('stats.sqlite', _sqlite(rows)))


def _parquet(rows: Sequence[Sequence[Value]]) -> bytes:
    import pyarrow  # a large library that only this format needs
    from pyarrow import parquet
    kinds = [pyarrow.string() if name in ('by', 'name') else pyarrow.int64()
             if name in _WHOLE else pyarrow.float64() for name in _COLUMNS]
    table = pyarrow.Table.from_pylist([dict(zip(_COLUMNS, row)) for row in rows],
                                      schema=pyarrow.schema(list(zip(_COLUMNS, kinds))))
    out = io.BytesIO()
    parquet.write_table(table, out)
    return out.getvalue()


def _sqlite(rows: Sequence[Sequence[Value]]) -> bytes:
    kinds = ['TEXT' if name in ('by', 'name') else 'INTEGER' if name in _WHOLE else 'REAL'
             for name in _COLUMNS]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'stats.sqlite'
        database = sqlite3.connect(path)
        try:
            columns = ', '.join(f'"{name}" {kind}' for name, kind in zip(_COLUMNS, kinds))
            database.execute(f'CREATE TABLE stats ({columns})')
            places = ', '.join('?' * len(_COLUMNS))
            database.executemany(f'INSERT INTO stats VALUES ({places})', rows)  # noqa: S608
            database.commit()
        finally:
            database.close()
        return path.read_bytes()


def verification_csv(found: Verification) -> str:
    """Return a verification as CSV, with a row for each vehicle of the reference."""
    rows = []
    for m in found.matches:
        v = m.vehicle
        numbers = (m.reference.speed_mps, m.reference.std_mps, None if v is None else v.speed_mps,
                   None if v is None else v.speed_std_mps, m.error_mps, m.reference.limit_mps)
        rows.append((m.reference.time_ns, m.reference.lane,
                     *('' if n is None else f'{n:.5f}' for n in numbers),
                     'no_pass' if v is None else v.reason or 'measured',
                     int(m.reference.is_good_enough)))
    return csv_text(('time_ns', 'lane', 'reference_mps', 'reference_std_mps', 'speed_mps',
                     'speed_std_mps', 'error_mps', 'limit_of_error_mps', 'outcome',
                     'reference_good_enough'), rows)


def verification_json(found: Verification) -> str:
    """Return the figures of a verification as JSON."""
    figures: dict[str, Any] = {
        'references': len(found.matches), 'counted': found.counted, 'within': found.within,
        'no_pass': found.without_pass, 'rejected': found.rejected,
        'reference_not_good_enough': found.not_good_enough,
        'passes_without_reference': found.strangers, 'mean_mps': found.mean_mps,
        'std_mps': found.std_mps, 'worst_mps': found.worst_mps, 'is_within': found.is_within,
        'passes_wanted': {c.name: {'wanted': c.wanted, 'had': c.had, 'missing': c.missing}
                          for c in found.claims}}
    return json.dumps(figures, indent=2, sort_keys=True, allow_nan=False) + '\n'
