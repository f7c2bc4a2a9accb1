# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``tamper``: damage copies of records of violations in many ways, and tabulate what is detected.

Bytes are flipped, files removed, added and swapped, the chain truncated, writers stopped. Exit
status 1 if any damage is missed.
"""
from __future__ import annotations

import argparse
from pathlib import Path
import shutil
import tempfile

import numpy as np

from ..evaluation.tamper import flipped_bytes, Outcome, spoilt_files, stopped_writers
from ...cli.options import number_in
from ...core.errors import InputError
from ...enforcement.verify import verify

MISSED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``tamper``."""
    parser.add_argument('folder', metavar='DIR', type=Path,
                        help='folder of records, as written by replay --evidence')
    parser.add_argument('--positions', type=number_in(int, 0, 10 ** 7), default=2000,
                        help='number of bytes to flip, one at a time (default: 2000)')
    parser.add_argument('--stops', type=number_in(int, 0, 10 ** 6), default=200,
                        help='number of writers to kill and of disks to fill (default: 200)')
    parser.add_argument('--seed', type=number_in(int, 0, 2 ** 31), default=0, metavar='S',
                        help='seed (default: 0)')


def run(args: argparse.Namespace) -> int:
    """Damage, verify, tabulate."""
    found = verify(args.folder)
    if not found.sound or not found.records:
        raise InputError(args.folder, 'evidence', found.faults or 'no record',
                         'sound records with their chain')
    rng = np.random.default_rng(args.seed)
    with tempfile.TemporaryDirectory() as aside:
        folder = Path(shutil.copytree(args.folder, Path(aside) / 'evidence'))
        outcomes = [flipped_bytes(folder, args.positions, rng)]
        _print_head(folder)
        _print(outcomes[0])
        for outcome in (*spoilt_files(folder),
                        stopped_writers(folder, args.stops, rng, kill=True),
                        stopped_writers(folder, args.stops, rng, kill=False)):
            _print(outcome)
            outcomes.append(outcome)
    return MISSED if any(outcome.missed for outcome in outcomes) else 0


def _print_head(folder: Path) -> None:
    files = [p for p in folder.rglob('*') if p.is_file()]
    print(f'{len(files)} files, {sum(p.stat().st_size for p in files)} bytes\n\n'
          '| damage | times | missed |\n|---|---|---|')


def _print(outcome: Outcome) -> None:
    print(f'| {outcome.damage} | {outcome.times} | {outcome.missed} |', flush=True)
