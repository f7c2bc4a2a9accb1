# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Fingerprints (SHA-256) of what determines a speed: software, parameters, site, calibration.

An approval covers one state of these; each record shows which state was running.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
import hashlib
import json
from pathlib import Path
from typing import Any, Mapping, Union

from ..core.errors import InputError
from ..core.strict_yaml import load_yaml, StrictMapping

KINDS = ('software', 'parameters', 'site', 'calibration')
_PACKAGE = Path(__file__).resolve().parents[1]
_ENDINGS = ('.py', '.json', '.html', '.so', '.pyx', '.cpp')
_HEX_DIGITS = 64


def canonical(data: Any) -> str:
    """Return the canonical JSON text of plain values: sorted keys, no spaces."""
    return json.dumps(data, sort_keys=True, separators=(',', ':'), ensure_ascii=True,
                      allow_nan=False)


def sha256(data: Union[bytes, str]) -> str:
    """Return the SHA-256 of bytes or of a text in UTF-8, hex."""
    return hashlib.sha256(data.encode() if isinstance(data, str) else data).hexdigest()


@cache
def software_fingerprint() -> str:
    """
    Return the fingerprint of the files of this package.

    It is the SHA-256 of the lines that ``sha256sum`` prints for them, in order of their paths.
    """
    files = sorted((p.relative_to(_PACKAGE).as_posix(), p) for p in _PACKAGE.rglob('*')
                   if p.suffix in _ENDINGS and '__pycache__' not in p.parts)
    return sha256(''.join(f'{sha256(path.read_bytes())}  {name}\n' for name, path in files))


@dataclass(frozen=True)
class Approved:
    """
    Approved fingerprints.

    :param where: file that they were read from; empty where none were given.
    :param of: approved fingerprints by kind; missing kinds are not checked.
    """

    where: str = ''
    of: Mapping[str, frozenset[str]] = field(default_factory=dict)

    def unknown(self, fingerprints: Mapping[str, str]) -> list[str]:
        """Return the kinds whose running fingerprint is not approved."""
        return [kind for kind in KINDS if kind in self.of
                and fingerprints[kind] not in self.of[kind]]


def load_approved(path: Union[str, Path]) -> Approved:
    """
    Read a file of approved fingerprints (YAML, ``stereo_speed_approved: 1``).

    Each of ``software``, ``parameters``, ``site`` and ``calibration`` may have a list.

    :raises InputError: names the first fault.
    """
    data = load_yaml(path, 'stereo_speed_approved')
    top = StrictMapping(path, '', data, ('stereo_speed_approved', *KINDS))
    of = {}
    for kind in KINDS:
        if kind in top:
            values = top.listed(kind)
            for value in values:
                if not isinstance(value, str) or len(value) != _HEX_DIGITS:
                    raise InputError(path, kind, repr(value), 'SHA-256 in 64 hex digits')
            of[kind] = frozenset(values)
    if not of:
        raise InputError(path, 'approved fingerprints', 'none', 'one of ' + ', '.join(KINDS))
    return Approved(str(path), of)
