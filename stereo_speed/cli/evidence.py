# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``evidence``: verify records of violations, measure them again, disclose copies, make a key.

The records are those that replay and evidence_node write. Exit status: 0 sound, 1 not sound,
2 bad input.
"""
from __future__ import annotations

import argparse
from pathlib import Path
import sys

from ..core.errors import InputError
from ..core.units import KMH_MPS
from ..enforcement.chain import load_public_key, write_key
from ..enforcement.disclose import disclose
from ..enforcement.recompute import recompute
from ..enforcement.verify import RECORD_FILE, verify

NOT_SOUND = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``evidence``."""
    actions = parser.add_subparsers(metavar='ACTION', required=True)
    check = actions.add_parser('verify', help='detect what was changed, removed, added or cut off')
    check.add_argument('folder', metavar='DIR', type=Path,
                       help='folder of all records, or of one record')
    check.add_argument('--head', type=Path, metavar='FILE',
                       help='head of the chain, if it is stored elsewhere')
    check.add_argument('--key', type=Path, action='append', default=[], metavar='PEM',
                       help='trusted public key; may be given several times')
    check.set_defaults(run=run_verify)
    again = actions.add_parser('recompute', help='measure again from the stored images')
    again.add_argument('record', metavar='RECORD', type=Path,
                       help='folder of a record, or its record.json')
    again.set_defaults(run=run_recompute)
    copy = actions.add_parser(
        'disclose', help='write a copy in which everything but the vehicle is blurred')
    copy.add_argument('record', metavar='RECORD', type=Path,
                      help='folder of a record, or its record.json')
    copy.add_argument('--out', required=True, type=Path, metavar='DIR', help='folder to write')
    copy.add_argument('--hide-plate', action='store_true',
                      help='also blur the front of the vehicle itself')
    copy.set_defaults(run=run_disclose)
    key = actions.add_parser('key', help='create a key for signing records')
    key.add_argument('--out', required=True, type=Path, metavar='PEM',
                     help='file of the private key; the public one is written beside it as .pub')
    key.set_defaults(run=run_key)


def run_verify(args: argparse.Namespace) -> int:
    """Verify the records and print every fault."""
    found = verify(args.folder, args.head, [load_public_key(path) for path in args.key])
    for line in found.faults:
        print(f'NOT SOUND: {line}', file=sys.stderr)
    for line in found.notes:
        print(f'note: {line}')
    for key in sorted(found.keys):
        print(f'signed by {key}')
    print(f'{args.folder}: {found.records} records, '
          + ('sound' if found.sound else f'{len(found.faults)} faults'))
    return 0 if found.sound else NOT_SOUND


def run_recompute(args: argparse.Namespace) -> int:
    """Measure a pass again and compare with the stored speed."""
    result = recompute(_folder(args.record))
    again = 'no speed: ' + result.reason if result.speed_mps is None else \
        f'{result.speed_mps:.6f} m/s ({result.speed_mps / KMH_MPS:.3f} km/h)'
    print(f'stored {result.stored_mps:.6f} m/s ({result.stored_mps / KMH_MPS:.3f} km/h), '
          f'measured again: {again}: '
          + ('agrees' if result.agrees else f'differs by more than {result.within_mps} m/s'))
    return 0 if result.agrees else NOT_SOUND


def run_disclose(args: argparse.Namespace) -> int:
    """Write a copy in which all but the vehicle are blurred."""
    print(f'copy in {disclose(_folder(args.record), args.out, hide_plate=args.hide_plate)}')
    return 0


def run_key(args: argparse.Namespace) -> int:
    """Write a new private key, readable by its owner only, and the public key beside it."""
    print(f'private key {args.out}, public key {write_key(args.out)}')
    return 0


def _folder(path: Path) -> Path:
    """Return the folder of a record, given the folder or its ``record.json``."""
    folder = path.parent if path.name == RECORD_FILE else path
    if not (folder / RECORD_FILE).is_file():
        raise InputError(path, 'record', 'no record.json', 'the folder of a record')
    return folder
