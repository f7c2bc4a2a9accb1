# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Write the passes of many runs as one table, in Parquet and in SQLite.

The columns are ``bag`` and those of ``passes.csv``; empty cells become null. The same runs give
the same bytes.
"""
from __future__ import annotations

import csv
from pathlib import Path
import sqlite3
from typing import Iterator, Mapping, Sequence, Union

import pyarrow
from pyarrow import parquet

from .atomic import PathLike, staged
from .results import kind_of, PASS_COLUMNS, PASSES
from ..core.errors import InputError

PARQUET, SQLITE = 'passes.parquet', 'passes.sqlite'
COLUMNS = ('bag', *PASS_COLUMNS)
_ROWS = 50_000  # rows held in memory at once

Value = Union[str, int, float, None]


def write_pass_tables(out_dir: PathLike, runs: Mapping[str, Path],
                      failed: Mapping[str, str]) -> int:
    """
    Write ``passes.parquet`` and ``passes.sqlite`` of a folder.

    The SQLite file has a second table, ``bags``, with a row for each bag and the reason why it
    failed, null where it did not.

    :param out_dir: the folder.
    :param runs: name of each bag to the folder of its run.
    :param failed: name of each failed bag to the reason.
    :return: number of passes.
    :raises InputError: the table of a run cannot be read, or the folder cannot be written.
    """
    kinds = {name: kind_of(name) for name in COLUMNS}
    arrow = {int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}
    schema = pyarrow.schema([(name, arrow[kind]) for name, kind in kinds.items()])
    count = 0
    with staged(out_dir, (SQLITE, PARQUET)) as aside:
        database = sqlite3.connect(aside / SQLITE)
        try:
            _make_tables(database, kinds)
            database.executemany('INSERT INTO bags VALUES (?, ?)', sorted(
                [*failed.items(), *((name, None) for name in runs)]))
            with parquet.ParquetWriter(aside / PARQUET, schema) as writer:
                for block in _blocks(runs):
                    count += len(block)
                    _insert(database, block)
                    writer.write_table(pyarrow.Table.from_pylist(
                        [dict(zip(COLUMNS, row)) for row in block], schema=schema))
            database.commit()
        except sqlite3.Error as error:
            raise InputError(Path(out_dir, SQLITE), 'database', error,
                             'a disk that can be written') from None
        finally:
            database.close()
    return count


def _make_tables(database: sqlite3.Connection, kinds: Mapping[str, type]) -> None:
    named = {int: 'INTEGER', float: 'REAL', str: 'TEXT'}
    columns = ', '.join(f'{name} {named[kind]}' for name, kind in kinds.items())
    database.execute(f'CREATE TABLE passes ({columns}, PRIMARY KEY (bag, track))')
    database.execute('CREATE TABLE bags (bag TEXT PRIMARY KEY, error TEXT)')


def _insert(database: sqlite3.Connection, rows: Sequence[Sequence[Value]]) -> None:
    places = ', '.join('?' * len(COLUMNS))
    database.executemany(f'INSERT INTO passes VALUES ({places})', rows)  # noqa: S608 (only ?)


def _blocks(runs: Mapping[str, Path]) -> Iterator[list[tuple[Value, ...]]]:
    """Yield the rows of all runs, by bag and track, in blocks that fit in memory."""
    block: list[tuple[Value, ...]] = []
    for name, folder in sorted(runs.items()):
        for row in _rows(folder / PASSES):
            block.append((name, *row))
            if len(block) == _ROWS:
                yield block
                block = []
    if block:
        yield block


def _rows(path: Path) -> Iterator[tuple[Value, ...]]:
    with path.open(newline='', encoding='utf-8') as file:
        reader = csv.reader(file)
        head = next(reader, [])
        if tuple(head) != PASS_COLUMNS:
            raise InputError(path, 'columns', ','.join(head) or 'nothing', ','.join(PASS_COLUMNS))
        for cells in reader:
            if len(cells) != len(PASS_COLUMNS):
                raise InputError(path, f'line {reader.line_num}', f'{len(cells)} cells',
                                 f'{len(PASS_COLUMNS)}')
            try:
                yield tuple(kind_of(name)(cell) if cell else None
                            for name, cell in zip(PASS_COLUMNS, cells))
            except ValueError as error:
                raise InputError(path, f'line {reader.line_num}', str(error),
                                 'numbers') from None
