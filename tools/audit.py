# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Compare pinned packages with known advisories, as `make audit` does, without the network.

``tools/advisories.json`` has the entries of PyPA's database for these packages on the date in the
file. Later advisories are not in it: `--extract` rewrites it from a checkout of that database.
"""
from __future__ import annotations

import argparse
import json
from pathlib import Path
import re
import subprocess
import sys
from typing import Any, Mapping, NamedTuple, Optional, Sequence

from packaging.version import InvalidVersion, Version
import yaml

ROOT = Path(__file__).resolve().parent.parent
KNOWN = ROOT / 'tools' / 'advisories.json'
SOURCE = 'https://github.com/pypa/advisory-database'


class Pin(NamedTuple):
    """A package and its pinned version."""

    name: str
    version: str


def canonical(name: str) -> str:
    """Return the normalised name of a package."""
    return re.sub(r'[-_.]+', '-', name).lower()


def pins_of(path: Path) -> list[Pin]:
    """
    Return the pins of a file.

    :raises ValueError: a line that pins nothing, so that it cannot be audited.
    """
    found = []
    for number, line in enumerate(path.read_text(encoding='utf-8').splitlines(), 1):
        text = line.partition('#')[0].strip()
        match = re.match(r'([\w.-]+)(?:\[[\w,-]+\])?==([\w.+!]+)(?:\s*;.*)?$', text)
        if match:
            found.append(Pin(canonical(match[1]), match[2]))
        elif text:
            raise ValueError(f'{path}: line {number}: found {text!r}, wanted NAME==VERSION')
    return found


def affects(advisory: Mapping[str, Any], version: str) -> bool:
    """Return whether an advisory affects a version."""
    if version in advisory['versions']:
        return True
    own = Version(version)
    return any(_between(own, low, high, last) for low, high, last in advisory['ranges'])


def _between(version: Version, low: str, fixed: Optional[str], last: Optional[str]) -> bool:
    """Return whether a version is in a range; None means no upper end."""
    if low != '0' and version < Version(low):
        return False
    if fixed is not None:
        return version < Version(fixed)
    return last is None or version <= Version(last)


def findings(pins: Sequence[Pin], known: Mapping[str, Any]) -> list[str]:
    """Return a line for each advisory that affects a pin."""
    return [f'{pin.name} {pin.version}: {advisory["id"]} '
            f'({", ".join(advisory["aliases"]) or "no other name"})'
            for pin in dict.fromkeys(pins) for advisory in known['advisories'].get(pin.name, ())
            if affects(advisory, pin.version)]


def extract(checkout: Path, names: Sequence[str]) -> dict[str, Any]:
    """
    Return the advisories for some packages from a checkout of the database.

    :param checkout: a git work tree or bare directory of the database.
    :param names: normalised names of the packages.
    """
    def git(*words: str) -> str:
        return subprocess.run(['git', '-C', str(checkout), *words],  # noqa: S607
                              check=True, capture_output=True, text=True).stdout
    files = git('ls-tree', '-r', '--name-only', 'HEAD', 'vulns').splitlines()
    wanted = [path for path in files if canonical(path.split('/')[1]) in names]
    told: dict[str, list[dict[str, Any]]] = {}
    for path in wanted:
        content = yaml.safe_load(git('show', f'HEAD:{path}'))
        if 'withdrawn' not in content:
            told.setdefault(canonical(path.split('/')[1]), []).append(_advisory(content))
    commit, date = git('log', '-1', '--format=%H %cs').split()
    return {'source': SOURCE, 'licence': 'CC-BY-4.0', 'commit': commit, 'date': date,
            'packages': sorted(names), 'advisories': dict(sorted(told.items()))}


def _advisory(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of an advisory (OSV) with the affected versions."""
    ranges: list[list[Optional[str]]] = []
    versions: set[str] = set()
    for affected in content.get('affected', ()):
        listed = [str(v) for v in affected.get('versions', ())]
        found = [r for r in affected.get('ranges', ()) if r['type'] == 'ECOSYSTEM']
        for one in found:
            ranges += _ranges(one['events'])
        if not found or any(not _is_version(v) for v in listed):
            versions.update(listed)
    return {'id': content['id'], 'aliases': list(content.get('aliases', ())), 'ranges': ranges,
            'versions': sorted(versions)}


def _ranges(events: Sequence[Mapping[str, Any]]) -> list[list[Optional[str]]]:
    """Return first, first fixed and last version of each range; None means no end."""
    out: list[list[Optional[str]]] = []
    for event in events:
        if 'introduced' in event:
            out.append([str(event['introduced']), None, None])
        elif 'fixed' in event:
            out[-1][1] = str(event['fixed'])
        elif 'last_affected' in event:
            out[-1][2] = str(event['last_affected'])
    return out


def _is_version(text: str) -> bool:
    try:
        Version(text)
    except InvalidVersion:
        return False
    return True


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Print the findings; return 1 if an advisory affects a pin, 2 if the audit is impossible."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('files', nargs='*', type=Path, default=[ROOT / 'requirements.lock'],
                        metavar='FILE', help='file with NAME==VERSION on each line')
    parser.add_argument('--extract', type=Path, metavar='CHECKOUT',
                        help=f'a git checkout of {SOURCE}: write {KNOWN.name} anew')
    args = parser.parse_args(argv)
    try:
        pins = [pin for path in args.files for pin in pins_of(path)]
        if args.extract is not None:
            known = extract(args.extract, sorted({pin.name for pin in pins}))
            KNOWN.write_text(json.dumps(known, indent=1) + '\n')
        known = json.loads(KNOWN.read_text())
    except (OSError, ValueError, KeyError, subprocess.CalledProcessError) as error:
        print(f'error: audit: {error}', file=sys.stderr)
        return 2
    unknown = sorted({pin.name for pin in pins} - set(known['packages']))
    found = findings(pins, known)
    for line in found:
        print(f'error: {line}', file=sys.stderr)
    count = sum(map(len, known['advisories'].values()))
    print(f'{len(set(pins))} pins held against the {count} advisories that {known["source"]} had '
          f'of {len(known["packages"])} packages on {known["date"]}: '
          f'{len(found) or "none"} applies')
    if unknown:
        print(f'NOT CHECKED: {", ".join(unknown)}: {KNOWN.name} was made without them')
    print('NOT CHECKED: what has become known since; where its service can be reached, '
          '`pip-audit --no-deps -r requirements.lock` tells')
    return 1 if found else 0


if __name__ == '__main__':
    sys.exit(main())
