# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged folders of evidence: their readers, and the detection of the damage."""
from __future__ import annotations

from contextlib import redirect_stdout
from functools import lru_cache
import io
import json
from pathlib import Path
import shutil
import tempfile
from typing import Callable

import numpy as np

from ..sim.damage import damage_bytes, damage_value
from ...cli.main import main
from ...core.errors import StereoSpeedError
from ...enforcement.disclose import disclose
from ...enforcement.recompute import recompute
from ...enforcement.verify import RECORD_FILE, verify

Rng = np.random.Generator
_READS = 0.3  # share of the cases that are measured again or disclosed, which takes a second


@lru_cache(maxsize=None)
def _evidence(sample: Path) -> Path:
    """Write a record of the sample's vehicle, once per process; return the folder of records."""
    out = Path(tempfile.mkdtemp(prefix='fuzz-evidence-'))
    with redirect_stdout(io.StringIO()):
        status = main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'),
                       '--init', str(sample / 'init.yaml'), '--particles', '60', '--evidence',
                       '--no-plots', '--out', str(out)])
    if status:
        raise StereoSpeedError(f'{sample}: replay ended with {status}')
    return out / 'evidence'


def evidence_case(sample: Path) -> Callable[[Rng, Path], Callable[[], object]]:
    """
    Return cases of a folder of evidence with one damaged file.

    :param sample: folder with bag/, site.yaml and init.yaml.
    """
    def case(rng: Rng, folder: Path) -> Callable[[], object]:
        where = Path(shutil.copytree(_evidence(sample), folder / 'evidence'))
        record, = (p.parent for p in where.rglob(RECORD_FILE))
        files = sorted(p for p in where.rglob('*') if p.is_file() and p.stat().st_size)
        path = files[int(rng.integers(len(files)))]
        reads = rng.random() < _READS
        if reads and rng.random() < 0.7:
            path = record / RECORD_FILE
        before = path.read_bytes()
        if path.suffix == '.json' and rng.random() < 0.6:
            after = json.dumps(damage_value(rng, json.loads(before)), default=str).encode()
        else:
            after = damage_bytes(rng, before)
        path.write_bytes(after)
        hide = bool(rng.random() < 0.5)
        if reads:
            return lambda: (recompute(record) and None) if hide else (
                disclose(record, folder / 'copy') and None)
        return lambda: _verified(where, path.relative_to(where), after == before)
    return case


def _verified(folder: Path, path: Path, same: bool) -> object:
    """Verify; return a text where damage is not detected, or a sound folder does not verify."""
    found = verify(folder)
    if found.sound != same:
        return f'{path}: found {"sound" if found.sound else found.faults}'
    return None
