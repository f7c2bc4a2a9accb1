# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Read the numbers in rows of CSV files, with the line of every fault."""
from __future__ import annotations

import csv
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Mapping

from .atomic import PathLike
from ..core.errors import InputError


@dataclass(frozen=True)
class CsvRow:
    """A row: its file and line for errors, and the text in each column."""

    path: PathLike
    line: str
    values: Mapping[str, str]

    def number(self, name: str, wanted: str, low: float = -1e300, high: float = 1e300,
               step: float = 0.0) -> Decimal:
        """
        Return a finite number without rounding; a stamp in ns has more digits than a float.

        :param wanted: what the number should be, for the error.
        :param step: the number must be a multiple of this; 0 allows any.
        :raises InputError: no number, or one that is not allowed.
        """
        try:
            value = Decimal(self.values[name] or 'nan')
        except InvalidOperation:
            value = Decimal('nan')
        if not (value.is_finite() and low <= value <= high) or (step and value % Decimal(step)):
            raise InputError(self.path, f'{self.line}, {name}', repr(self.values[name]), wanted)
        return value


def read_rows(path: PathLike, kind: str) -> tuple[tuple[str, ...], list[CsvRow]]:
    """
    Return the columns and the rows of a file.

    :param kind: what the file should be, for errors.
    :raises InputError: a file that cannot be read, a row without a value for each column.
    """
    try:
        lines = Path(path).read_text(encoding='utf-8-sig').splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, 'file', error, f'a readable {kind}') from None
    reader, rows = csv.DictReader(lines, strict=True), []
    try:
        for row in reader:
            if None in row or None in row.values():
                raise InputError(path, f'line {reader.line_num}', 'a different number of values',
                                 'one value for each column')
            rows.append(CsvRow(path, f'line {reader.line_num}', row))
    except csv.Error as error:
        raise InputError(path, f'line {reader.line_num + 1}', error,
                         'a row of a CSV file') from None
    return tuple(reader.fieldnames or ()), rows
