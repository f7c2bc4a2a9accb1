# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Check that this commit can be released, as `make release-check` does.

The tree must be clean; the version must be the same everywhere and have a heading in the
changelog; wheel and sdist must build, and the sdist's wheel must match the tree; the wheel must
install in an empty environment with its dependencies, and measure the sample there, offline and
with the live nodes.
"""
from __future__ import annotations

import argparse
import os
from pathlib import Path
import re
import runpy
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree  # noqa: S405 (it reads our own package.xml)
import zipfile

ROOT = Path(__file__).resolve().parent.parent


class CheckError(Exception):
    """The commit cannot be released."""


def run(*command: object, where: Path = ROOT, seconds: float = 900) -> str:
    """Run a program and return its output."""
    alone = {name: value for name, value in os.environ.items() if name != 'PYTHONPATH'}
    try:
        done = subprocess.run([str(word) for word in command], cwd=where, text=True, env=alone,
                              capture_output=True, stdin=subprocess.DEVNULL, timeout=seconds)
    except subprocess.TimeoutExpired:
        raise CheckError(f'{command[0]} takes more than {seconds:g} s') from None
    if done.returncode:
        raise CheckError(f'{" ".join(map(str, command))}: exit {done.returncode}\n'
                         f'{done.stdout[-2000:]}{done.stderr[-2000:]}')
    return done.stdout


def check_tree() -> str:
    """Refuse a tree with uncommitted changes."""
    changed = run('git', 'status', '--porcelain').splitlines()
    if changed:
        raise CheckError(f'the tree is not clean: {", ".join(line[3:] for line in changed[:8])}')
    return 'the tree is clean'


def check_versions(root: Path = ROOT) -> str:
    """Compare the versions of package, manifest, set-up and changelog."""
    source = (root / 'stereo_speed' / '__init__.py').read_text()
    found = {
        'stereo_speed/__init__.py': runpy.run_path(
            str(root / 'stereo_speed' / '__init__.py'))['__version__'] if source else '',
        'package.xml': ElementTree.parse(  # noqa: S314 (our own)
            root / 'package.xml').getroot().findtext('version'),
        'setup.py': (re.search(r"version='([^']*)'", (root / 'setup.py').read_text())
                     or ['', ''])[1],
        'CHANGELOG.rst': (re.search(r'^(\d+\.\d+\.\d+) \(\d{4}-\d\d-\d\d\)\n-+$', (
            root / 'CHANGELOG.rst').read_text(), re.MULTILINE) or ['', 'no release'])[1]}
    if len(set(found.values())) > 1:
        raise CheckError('versions differ: ' + ', '.join(f'{k} {v}' for k, v in found.items()))
    if re.search(r'^Forthcoming$', (root / 'CHANGELOG.rst').read_text(), re.MULTILINE):
        raise CheckError('CHANGELOG.rst still has a heading Forthcoming')
    return f'version {found["setup.py"]} everywhere'


def build(out: Path) -> Path:
    """Build the sdist, and the wheel from it; compare it with the tree; return the wheel."""
    run(sys.executable, '-m', 'build', '--no-isolation', '--outdir', out)
    wheel, = out.glob('*.whl')
    packed = {name for name in zipfile.ZipFile(wheel).namelist()
              if name.startswith('stereo_speed/')}
    tracked = set(run('git', 'ls-files', 'stereo_speed').split())
    if packed != tracked:
        raise CheckError(f'wheel and tree differ: {sorted(packed ^ tracked)[:8]}')
    return wheel


def check_wheel(wheel: Path, folder: Path) -> str:
    """Install the wheel in an empty environment, and measure the sample there."""
    run(sys.executable, '-m', 'venv', folder / 'venv')
    python = folder / 'venv' / 'bin' / 'python'
    run(python, '-m', 'pip', 'install', '--quiet', '--disable-pip-version-check', '--constraint',
        ROOT / 'requirements.lock', f'{wheel}[pypi]')
    where = run(python, '-c', 'import stereo_speed; print(stereo_speed.__file__)', where=folder)
    if not Path(where.strip()).is_relative_to(folder):
        raise CheckError(f'the installed package is {where}')
    sample = folder / 'venv' / 'share' / 'stereo_speed' / 'sample' / 'straight55'
    run(python, '-m', 'stereo_speed', 'replay', sample / 'bag', '--site', sample / 'site.yaml',
        '--out', folder / 'replay', where=folder)
    run(python, '-m', 'stereo_speed', 'demo', '--out', folder / 'demo', where=folder)
    return f'{wheel.name} installs in an empty environment and runs the demo there'


def main() -> int:
    """Run the checks in order; print each that passes, and the first that fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--draft', action='store_true',
                        help='skip the checks of clean tree and versions')
    args = parser.parse_args()
    try:
        for check in () if args.draft else (check_tree, check_versions):
            print(check(), flush=True)
        with tempfile.TemporaryDirectory(prefix='release-') as folder:
            wheel = build(Path(folder) / 'dist')
            print('wheel and sdist build, and hold what the tree holds', flush=True)
            print(check_wheel(wheel, Path(folder)), flush=True)
    except CheckError as error:
        print(f'error: {error}', file=sys.stderr)
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
