# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``stats``: traffic statistics over many runs.

Count, mean, median, 85th percentile, 10 mph pace and share over the limit: of all passes, and by
lane, direction, class and hour.
"""
from __future__ import annotations

import argparse
from pathlib import Path
from zoneinfo import ZoneInfo

from .options import add_units_option
from ..core.units import SpeedUnit
from ..io.atomic import prepare_folder, write_whole
from ..io.pass_rows import read_vehicles
from ..io.survey_files import FORMATS, traffic_file
from ..survey.traffic import traffic_groups

REPORT = 'stats.html'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``stats``."""
    add = parser.add_argument
    add('places', metavar='DIR', nargs='+', type=Path,
        help='folders written by replay, folders of such folders, or SQLite files with passes')
    add('--out', required=True, type=Path, metavar='DIR', help='folder to write')
    add('--format', choices=FORMATS, default='csv', help='format of the table (default: csv)')
    add('--timezone', type=_zone, default='UTC', metavar='NAME',
        help='time zone of the hours, such as Europe/Madrid (default: UTC)')
    add_units_option(parser)


def _zone(text: str) -> ZoneInfo:
    try:
        return ZoneInfo(text)
    except (KeyError, ValueError, OSError):
        raise argparse.ArgumentTypeError(
            f'found {text!r}, wanted a time zone such as Europe/Madrid') from None


def run(args: argparse.Namespace) -> int:
    """Read the passes, write table and report, print the table."""
    from ..report.survey import traffic_columns, traffic_page, traffic_rows  # matplotlib is slow
    vehicles = read_vehicles(args.places)
    prepare_folder(args.out)
    unit, groups = SpeedUnit(args.units), traffic_groups(vehicles, args.timezone)
    name, content = traffic_file(groups, args.format)
    older = [REPORT, *(f'stats.{form}' for form in FORMATS)]
    write_whole(args.out, {name: content, REPORT: traffic_page(groups, vehicles, unit)}, older)
    rows = [traffic_columns(unit), *traffic_rows(groups, unit)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        print('  '.join(f'{cell:<{width}}' for cell, width in zip(row, widths)).rstrip())
    print(f'table in {args.out / name}, report in {args.out / REPORT}')
    return 0
