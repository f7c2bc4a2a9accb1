# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Check that every key of package.xml is in the public rosdep lists, and write the allowed keys.

Usage: rosdep_keys.py CHECKOUT, a git checkout of https://github.com/ros/rosdistro.
"""
from __future__ import annotations

from pathlib import Path
import subprocess
import sys
from typing import Any, Mapping
import xml.etree.ElementTree as ElementTree  # noqa: S405 (it reads our own package.xml)

import yaml

ROOT = Path(__file__).resolve().parent.parent
LIST = ROOT / 'tools' / 'rosdep_keys.txt'
DISTRO = 'jazzy'


def known_keys(python: Mapping[str, Any], distribution: Mapping[str, Any]) -> set[str]:
    """
    Return the keys that resolve on Ubuntu: packages of Ubuntu, and those of the distribution.

    :param python: content of ``rosdep/python.yaml``.
    :param distribution: content of ``<distro>/distribution.yaml``.
    """
    found = {key for key, where in python.items() if _is_packaged(where.get('ubuntu'))}
    for name, repository in distribution['repositories'].items():
        if 'release' in repository:
            found.update(repository['release'].get('packages', [name]))
    return found


def _is_packaged(where: Any) -> bool:
    """Return whether Ubuntu has a package, instead of pip only."""
    return bool(where) and not (isinstance(where, dict) and set(where) == {'pip'})


def main() -> int:
    """Compare and write; return 1 where a key is unknown."""
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        return 2

    def git(*words: str) -> str:
        return subprocess.run(['git', '-C', sys.argv[1], *words],  # noqa: S607
                              check=True, capture_output=True, text=True).stdout
    python, distribution = (yaml.safe_load(git('show', f'HEAD:{path}')) for path in (
        'rosdep/python.yaml', f'{DISTRO}/distribution.yaml'))
    known = known_keys(python, distribution)
    manifest = ElementTree.parse(ROOT / 'package.xml').getroot()  # noqa: S314 (our own)
    named = {str(e.text) for e in manifest if e.tag.endswith('depend')}
    listed = {line for line in LIST.read_text().splitlines() if line and line[0] != '#'}
    unknown = sorted((named | listed) - known)
    if unknown:
        print(f'error: package.xml or {LIST.name}: {", ".join(unknown)}: found no such key, '
              f'wanted those of Ubuntu or {DISTRO}', file=sys.stderr)
        return 1
    commit, date = git('log', '-1', '--format=%H %cs').split()
    keys = sorted(named | listed)
    LIST.write_text('\n'.join([
        '# What package.xml may name, checked against https://github.com/ros/rosdistro at commit',
        f'# {commit} ({date}) by tools/rosdep_keys.py.',
        '# Keys of rosdep/python.yaml that Ubuntu has a package for:',
        *(key for key in keys if key in python), f'# Packages of {DISTRO}/distribution.yaml:',
        *(key for key in keys if key not in python)]) + '\n')
    print(f'{len(named)} keys of package.xml are known')
    return 0


if __name__ == '__main__':
    sys.exit(main())
