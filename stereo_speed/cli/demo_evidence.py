# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The end of the demo: verify the record of a violation, and detect a forged copy of it."""
from __future__ import annotations

import json
from pathlib import Path
import shutil

from ..core.errors import StereoSpeedError
from ..enforcement.chain import load_public_key, public_of, write_key
from ..enforcement.page import speeds
from ..enforcement.recompute import recompute
from ..enforcement.verify import RECORD_FILE, verify

FORGED = 'evidence_forged'
_FASTER = 10  # added to the speeds of the forged copy, in the record's unit


def demo_key(out: Path) -> Path:
    """Return the key that signs the demo's records; create it where it is missing."""
    path = out / 'demo_key.pem'
    if not path.exists():
        write_key(path)
    return path


def records(folder: Path) -> set[Path]:
    """Return the folders of the complete records."""
    return {path.parent for path in folder.glob(f'*/{RECORD_FILE}')
            if not path.parent.name.startswith('.')}


def show(out: Path, record_folder: Path, key: Path) -> list[str]:
    """
    Return the lines that the demo prints on a record and on a forged copy, which it makes.

    :param out: folder of the demo.
    :param record_folder: folder of the record.
    :param key: private key that signed it.
    :raises StereoSpeedError: the record does not verify, or the forged copy does.
    """
    record = json.loads((record_folder / RECORD_FILE).read_text())
    figures = ', '.join(f'{name} {value}' for name, value in speeds(record))
    trusted = [load_public_key(public_of(key))]
    found, again = verify(record_folder.parent, trusted=trusted), recompute(record_folder)
    forged = verify(forge(record_folder, out / FORGED), trusted=trusted)
    if not found.sound or not again.agrees or forged.sound:
        raise StereoSpeedError(f'{record_folder}: record: found '
                               f'{"; ".join(found.faults) or again}, forged copy '
                               f'{forged.faults}, wanted a sound record and a detected forgery')
    check = 'python -m stereo_speed evidence verify'
    option = f'--key {public_of(key)}'
    return [
        f'violation on {record["place"]["lane"]}: {figures}',
        f'  record   {record_folder / RECORD_FILE}', f'  report   {record_folder / "page.html"}',
        f'  report   {record_folder / "page.pdf"}',
        f'  measured again from its images: {again.speed_mps:.6f} m/s, stored '
        f'{again.stored_mps:.6f} m/s',
        f'verified: {found.records} records, signed and sound; check them with:',
        f'  {check} {record_folder.parent} {option}',
        f'a copy whose speed was raised by {_FASTER} {record["speed"]["unit"]} is detected:',
        *(f'  NOT SOUND: {fault}' for fault in forged.faults),
        f'  {check} {out / FORGED} {option}']


def forge(record_folder: Path, target: Path) -> Path:
    """Copy a record's folder with its chain, raise the speed of the copy, and return it."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(record_folder.parent, target)
    path = target / record_folder.name / RECORD_FILE
    record = json.loads(path.read_text())
    for name in ('measured', 'considered'):
        record['speed'][name] += _FASTER
    path.write_text(json.dumps(record, indent=1, sort_keys=True) + '\n')
    return target
