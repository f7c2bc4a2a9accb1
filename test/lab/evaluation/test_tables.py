# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Tables as Markdown and CSV."""
from __future__ import annotations

import csv
import io

import pytest
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.tables import mph, shown, signed, Table

TABLE = Table(title='t', columns=('a', 'b', 'c'), digits=(0, 2, 3), note='so',
              rows=[['x|y', float('nan'), 1.23456], [None, 7, float('inf')]])


def test_markdown_has_dashes_for_unknown_values_and_escapes_bars():
    assert TABLE.markdown() == (
        '**t**\n\n| a | b | c |\n|---|---|---|\n| x\\|y | - | 1.235 |\n| - | 7 | - |\n\nso\n')


def test_csv_has_empty_unknown_values_and_five_digits():
    assert list(csv.reader(io.StringIO(TABLE.csv()))) == [
        ['a', 'b', 'c'], ['x|y', '', '1.23456'], ['', '7', '']]


def test_one_number_of_digits_applies_to_all_columns_and_titles_are_optional():
    table = Table(title='', columns=('a', 'b'), rows=[[1.25, 2]], digits=1)
    assert table.markdown() == '| a | b |\n|---|---|\n| 1.2 | 2 |\n'


@pytest.mark.parametrize(('cell', 'text'), [
    (1.005, '1.00'), (3, '3'), ('words', 'words'), (None, '-'), (float('nan'), '-')])
def test_cells(cell, text):
    assert shown(cell, 2) == text


def test_speeds_are_in_mph():
    assert mph(MPH_MPS) == 1.0 and mph(None) is None
    assert signed(0.5 * MPH_MPS) == '+0.500'
    assert signed(-0.5 * MPH_MPS, digits=1) == '-0.5'
    assert signed(float('nan')) == '-'
