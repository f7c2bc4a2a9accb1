# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``replay-many``: measure the vehicles of many bags, each as replay does, into DIR/NAME/.

All passes are also written to one table. An interrupted run resumes where it stopped; a bag that
cannot be measured does not affect the others.
"""
from __future__ import annotations

import argparse
from contextlib import redirect_stderr, redirect_stdout
import io
import os
from pathlib import Path
import shutil
import sys
from typing import Any, Mapping, Optional, Sequence

from . import replay
from .options import number_in
from .replay_parts import files_of, shared_options
from ..batch.job import Job, Result
from ..batch.runner import run_jobs
from ..core.errors import InputError
from ..io.atomic import prepare_folder
from ..io.results import file_sha256, PASSES, software_versions, SUMMARY, TRACKS

_FILES = (TRACKS, PASSES, SUMMARY)  # their hashes identify a finished run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``replay-many``."""
    parser.add_argument('bags', metavar='BAG', nargs='+', type=Path,
                        help='rosbag2 folders, .mcap or .db3 files, or ROS 1 .bag')
    replay.add_options(parser)
    where = parser.add_mutually_exclusive_group()
    where.add_argument('--jobs', type=number_in(int, 0, 512), default=os.cpu_count() or 1,
                       metavar='N', help='number of processes (default: one per core; 0: only '
                       'this one)')
    where.add_argument('--dask', default='', metavar='ADDRESS', help='scheduler of a Dask '
                       'cluster, such as tcp://host:8786; its workers need access to the same '
                       'files')


def run(args: argparse.Namespace) -> int:
    """Measure every bag, write the tables, then print the failures."""
    # Imported before the work begins, because its library may be missing.
    from ..io.pass_tables import PARQUET, SQLITE, write_pass_tables
    replay.check(args)
    prepare_folder(args.out)
    names = folder_names(args.bags)
    options = shared_options(args)
    jobs = [Job(key=name, parameters={
        'bag': str(bag.resolve()), 'files': files_of(bag),
        'out': str((args.out / name).resolve()), **options}) for name, bag in names.items()]
    results = run_jobs(jobs, measure, out_dir=args.out, workers=args.jobs,
                       description='replay-many', cluster=args.dask,
                       still_good=lambda result: _is_whole(args.out, result))
    good = {r.key: r.value for r in results if r.value is not None}
    failed = {r.key: r.error for r in results if r.error}
    for name, value in good.items():
        for line in value['warnings']:
            print(f'{name}: {line}', file=sys.stderr)
    count = write_pass_tables(args.out, {name: args.out / name for name in good}, failed)
    print(f'{len(good)} of {len(names)} bags, {count} passes; in {args.out / PARQUET}, '
          f'{args.out / SQLITE} and a folder for each bag')
    for name, error in failed.items():
        print(f'error: {name}: {error}', file=sys.stderr)
    return _status(results)


def folder_names(bags: Sequence[Path]) -> dict[str, Path]:
    """
    Name the output folder of each bag.

    The name is the bag's own, without the suffix of a file. Equal names are prefixed with the
    folders above them, joined by ``-``, as far up as needed to make them unique.

    :param bags: the bags, in any order.
    :raises InputError: one bag twice.
    """
    places = [bag.resolve() for bag in bags]
    for place in places:
        if places.count(place) > 1:
            raise InputError('replay-many', 'bags', f'{place} twice', 'each bag once')
    parts = [(*place.parts[1:-1], place.name if place.is_dir() else place.stem)
             for place in places]
    depths = [1] * len(parts)
    while True:
        names = ['-'.join(part[-depth:]) for part, depth in zip(parts, depths)]
        alike = [k for k, name in enumerate(names) if names.count(name) > 1]
        if not alike:
            return dict(zip(names, bags))
        if all(depths[k] >= len(parts[k]) for k in alike):
            raise InputError('replay-many', 'bags', f'several with the name {names[alike[0]]}',
                             'bags whose names without suffix differ')
        for k in alike:
            depths[k] += 1


def measure(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """
    Measure one bag; runs in its own process.

    :param parameters: parameters of the job: bag, folder and options.
    :return: hashes of the written files, and the warnings.
    :raises InputError: input that ``replay`` refuses, other library versions, changed inputs.
    """
    found = software_versions()
    if found != parameters['versions']:
        raise InputError('worker', 'versions', found, str(parameters['versions']))
    for path, digest in parameters['inputs'].items():
        if file_sha256(Path(path)) != digest:
            raise InputError(path, 'file', 'different content from when the run began',
                             'an unchanged file')
    out = Path(parameters['out'])
    for left in out.glob('.partial-*'):  # left behind by a killed process
        shutil.rmtree(left, ignore_errors=True)
    args = argparse.Namespace(**{name: _from_plain(value)
                                 for name, value in parameters['options'].items()},
                              bag=Path(parameters['bag']), out=out)
    told = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(told):
        replay.run(args, beside=False)  # the other cores are busy with other bags
    return {'files': {name: file_sha256(out / name) for name in _FILES},
            'warnings': [line for line in told.getvalue().splitlines() if line.strip()]}


def _from_plain(value: Any) -> Any:
    return Path(value['path']) if isinstance(value, dict) else value


def _is_whole(out_dir: Path, result: Result) -> bool:
    """Return whether the files of an earlier finished run still exist unchanged."""
    files = (result.value or {}).get('files', {})
    return set(files) == set(_FILES) and all(
        _hash(out_dir / result.key / name) == digest for name, digest in files.items())


def _hash(path: Path) -> Optional[str]:
    return file_sha256(path) if path.is_file() else None


def _status(results: Sequence[Result]) -> int:
    """Return 0 when all bags were measured, 2 when some were refused, 1 when any crashed."""
    errors = [r for r in results if r.error]
    if not errors:
        return 0
    return 2 if all(r.refused for r in errors) else 1
