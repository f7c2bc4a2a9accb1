# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``verify-against``: match measured passes with the vehicles of a reference, by time and lane.

The reference is an instrument such as a lidar gate or a car with GPS. The report has the errors,
and how many more passes are needed for a claim of accuracy.
"""
from __future__ import annotations

import argparse
from pathlib import Path

from .options import add_units_option, number_in
from ..core.units import SpeedUnit
from ..io.atomic import prepare_folder, write_whole
from ..io.pass_rows import read_references, read_vehicles
from ..io.survey_files import verification_csv, verification_json
from ..survey.reference import verification

REPORT, FIGURES, TABLE = 'verification.html', 'verification.json', 'verification.csv'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``verify-against``."""
    add = parser.add_argument
    add('reference', metavar='REFERENCE.csv', type=Path,
        help='CSV with time_ns,lane,speed_mps,std_mps, one row per vehicle; times by the clock of '
             'the pairs')
    add('--passes', required=True, type=Path, metavar='DIR',
        help='folder written by replay, folder of such folders, or SQLite file with passes')
    add('--out', required=True, type=Path, metavar='DIR', help='folder to write')
    add('--tolerance-s', type=number_in(float, 0, 60), default=1.0, metavar='S',
        help='greatest time of the reference before the first pair of a pass, or after its last '
             '(default: 1)')
    add_units_option(parser)


def run(args: argparse.Namespace) -> int:
    """Read both, write report, figures and table, print the result."""
    from ..report.survey import verification_page  # matplotlib takes a second to load
    references, vehicles = read_references(args.reference), read_vehicles([args.passes])
    prepare_folder(args.out)
    unit, found = SpeedUnit(args.units), verification(references, vehicles, args.tolerance_s)
    write_whole(args.out, {
        TABLE: verification_csv(found), FIGURES: verification_json(found),
        REPORT: verification_page(found, unit)}, [FIGURES, TABLE, REPORT])
    print(f'{found.counted} of {len(references)} reference vehicles count; '
          f'mean {unit.signed(found.mean_mps, 3)}, sd {unit.of(found.std_mps, 3)}, '
          f'worst {unit.signed(found.worst_mps, 3)} {unit.name}; '
          f'{found.within} within ±3 km/h, ±3 % above 100 km/h')
    for claim in found.claims:
        print(f'{claim.name}: {claim.wanted} passes needed, {claim.missing} of them missing')
    print(args.out / REPORT)
    return 0
