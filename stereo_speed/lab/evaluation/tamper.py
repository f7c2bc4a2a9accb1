# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Damage records in many ways, and check that the damage is detected."""
from __future__ import annotations

from dataclasses import dataclass
import errno
from functools import partial
from itertools import product
import multiprocessing
import os
from pathlib import Path
import shutil
import signal
import stat
import tempfile
from typing import Callable, Iterator, Sequence
from unittest import mock

import numpy as np

from ...core.errors import StereoSpeedError
from ...enforcement.chain import seal_of
from ...enforcement.store import EvidenceStore, StoreError
from ...enforcement.verify import CHAIN_FILE, RECORD_FILE, SEAL_FILE, verify

_ANEW_EVERY = 5  # number of stops after which the store is emptied
_DISK_FULL = 28  # exit status of a writer whose disk is full
_PATIENCE_S = 120.0


@dataclass(frozen=True)
class Outcome:
    """
    The outcome of one kind of damage.

    :param damage: description of the damage.
    :param times: how often it was done.
    :param missed: how often it was not detected, or left an invalid store.
    """

    damage: str
    times: int
    missed: int


def flipped_bytes(folder: Path, positions: int, rng: np.random.Generator) -> Outcome:
    """
    Flip one bit of one stored byte at a time; the bytes are drawn from all stored files.

    :param folder: folder of sound records; it is not changed in the end.
    :param positions: number of bytes.
    :param rng: source of randomness.
    """
    files = sorted(p for p in folder.rglob('*') if p.is_file())
    ends = np.cumsum([p.stat().st_size for p in files])
    missed = 0
    for at in rng.integers(0, ends[-1], positions):
        number = int(np.searchsorted(ends, at, side='right'))
        path = files[number]
        data = path.read_bytes()
        offset = int(at - ends[number] + len(data))
        spoilt = bytes([data[offset] ^ 1 << int(rng.integers(8))])
        path.write_bytes(data[:offset] + spoilt + data[offset + 1:])
        missed += verify(folder).sound
        path.write_bytes(data)
    return Outcome('one bit of one stored byte flipped', positions, missed)


def damages(folder: Path) -> Iterator[tuple[str, Callable[[Path], None]]]:
    """
    Yield kinds of damage to files and chain, each with a function that applies it to a copy.

    :param folder: folder of at least two records.
    """
    names = [seal.record_id for line in (folder / CHAIN_FILE).read_text().splitlines()
             if (seal := seal_of(line)) is not None]
    lines = len(names)
    for path in sorted(p for p in folder.rglob('*') if p.is_file()):
        inside = path.relative_to(folder)
        yield 'file removed', partial(_remove, inside)
        yield 'file cut by a byte', partial(_cut, inside)
        yield 'file added', partial(_copy, inside)
    for name, other in product(names, names):
        if name == other:
            yield 'record removed', partial(_remove, Path(name))
            yield 'record added', partial(_copy, Path(name))
            continue
        for file in (RECORD_FILE, SEAL_FILE, ''):
            yield 'files or folders of two records swapped', partial(
                _swap, Path(name, file), Path(other, file))
    for kept in range(lines):
        yield 'chain cut', partial(_keep, range(kept))
        yield 'entry of the chain removed', partial(
            _keep, [n for n in range(lines) if n != kept])
        yield 'chain and last records removed', partial(_end, names, kept)
    if lines > 1:
        yield 'entries reordered', partial(_keep, range(lines)[::-1])
    yield 'entry doubled', partial(_keep, [*range(lines), lines - 1])


def spoilt_files(folder: Path) -> list[Outcome]:
    """Apply each kind of :func:`damages` to copies of records, and return the outcomes."""
    counts: dict[str, list[int]] = {}
    with tempfile.TemporaryDirectory(dir=folder.parent) as aside:
        for kind, spoil in damages(folder):
            copy = Path(shutil.copytree(folder, Path(aside) / 'copy'))
            spoil(copy)
            count = counts.setdefault(kind, [0, 0])
            count[0] += 1
            count[1] += verify(copy).sound
            shutil.rmtree(copy)
    return [Outcome(kind, *count) for kind, count in counts.items()]


def stopped_writers(folder: Path, times: int, rng: np.random.Generator, *, kill: bool,
                    patience_s: float = _PATIENCE_S) -> Outcome:
    """
    Stop a writer of records at random steps, by SIGKILL or by a full disk, repeatedly.

    A step is a sync or a renaming. Half of a file that is about to be synced may be missing, as
    after a power cut or on a full disk. After each stop the store must verify, have every finished
    record and no incomplete one, and accept the next.

    :param folder: folder of sound records, whose contents are written again.
    :param times: number of stops.
    :param rng: source of randomness.
    :param kill: whether to stop by SIGKILL; else the disk is full from that step on.
    :param patience_s: longest run time of a writer.
    :raises StereoSpeedError: a writer ends by itself, or does not end.
    """
    contents = [_contents(p) for p in sorted(folder.iterdir()) if p.is_dir()]
    status, missed = -signal.SIGKILL if kill else _DISK_FULL, 0
    with tempfile.TemporaryDirectory(dir=folder.parent) as aside:
        steps = _write(Path(aside) / 'whole', contents, _Stop())
        (Path(aside) / 'finished').unlink()
        for number in range(times):
            target = Path(aside) / 'store'
            with EvidenceStore(target):
                pass
            stop = _Stop(int(rng.integers(1, steps + 1)), kill, bool(rng.integers(2)))
            process = multiprocessing.get_context('fork').Process(
                target=_write, args=(target, contents, stop))
            process.start()
            process.join(patience_s)
            if process.exitcode != status:  # another cause, so the test is not valid
                process.kill()
                raise StereoSpeedError(f'{folder}: a writer that was to be stopped ended with '
                                       f'{process.exitcode}, not with {status}')
            missed += not _recovers(target, contents)
            if number % _ANEW_EVERY == _ANEW_EVERY - 1:
                shutil.rmtree(target)
    return Outcome('writer killed' if kill else 'disk full', times, missed)


@dataclass(frozen=True)
class _Stop:
    """
    The stop of a writer.

    :param at: the step, from 1; 0 for never.
    :param kill: whether to stop by SIGKILL; else the disk is full from that step on.
    :param torn: whether half of a file that is about to be synced is lost.
    """

    at: int = 0
    kill: bool = False
    torn: bool = False

    def before(self, step: int, args: Sequence[object]) -> None:
        """Stop if the step is the chosen one."""
        if not self.at or (step != self.at if self.kill else step < self.at):
            return
        if self.torn and isinstance(args[0], int) and stat.S_ISREG(os.fstat(args[0]).st_mode):
            os.ftruncate(args[0], os.fstat(args[0]).st_size // 2)
        if self.kill:
            os.kill(os.getpid(), signal.SIGKILL)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob('*')
            if p.is_file() and p.name != SEAL_FILE}


def _named(content: dict[str, bytes], name: str) -> tuple[dict[str, bytes], bytes]:
    """Return the files of a record under another name, and its ``record.json``."""
    files = {key: value for key, value in content.items() if key != RECORD_FILE}
    text = content[RECORD_FILE].decode()
    start = text.index('"id": "') + len('"id": "')
    return files, (text[:start] + name + text[text.index('"', start):]).encode()


def _write(target: Path, contents: Sequence[dict[str, bytes]], stop: _Stop) -> int:
    """
    Write records until stopped, and return the number of steps.

    Finished records are listed in a file beside the store. A full disk ends the process.
    """
    seen = 0

    def wrapped(real: Callable[..., object]) -> Callable[..., object]:
        def call(*args: object, **options: object) -> object:
            nonlocal seen
            seen += 1
            stop.before(seen, args)
            return real(*args, **options)
        return call
    told = target.parent / 'finished'
    with EvidenceStore(target) as store:
        with mock.patch.multiple(os, fsync=wrapped(os.fsync), rename=wrapped(os.rename),
                                 replace=wrapped(os.replace)):
            for content in contents:
                name = f'r{store.next_number:05d}'
                try:
                    store.add(name, *_named(content, name))
                except StoreError as error:
                    raise SystemExit(_DISK_FULL) from error
                with told.open('a') as stream:
                    stream.write(f'{name}\n')
    if 0 < stop.at <= seen:  # the last record was finished nevertheless
        raise SystemExit(_DISK_FULL)
    return seen


def _recovers(target: Path, contents: Sequence[dict[str, bytes]]) -> bool:
    """Return whether a store verifies after a stop, is complete and takes the next record."""
    told = target.parent / 'finished'
    finished = told.read_text().split() if told.exists() else []
    told.unlink(missing_ok=True)
    if not verify(target).sound:
        return False
    try:
        with EvidenceStore(target) as store:
            if any(store.find(name) is None for name in finished):
                return False
            name = f'r{store.next_number:05d}'
            store.add(name, *_named(contents[0], name))
            count = store.next_number - 1
    except StereoSpeedError:
        return False
    found = verify(target)
    return found.sound and found.records == count


def _remove(name: Path, folder: Path) -> None:
    path = folder / name
    shutil.rmtree(path) if path.is_dir() else path.unlink()


def _cut(name: Path, folder: Path) -> None:
    os.truncate(folder / name, (folder / name).stat().st_size - 1)


def _copy(name: Path, folder: Path) -> None:
    path, copy = folder / name, folder / f'{name}.copy'
    if path.is_dir():
        shutil.copytree(path, copy)
    else:
        shutil.copy(path, copy)


def _swap(name: Path, other: Path, folder: Path) -> None:
    a, b, aside = folder / name, folder / other, folder.with_name('swap')
    a.rename(aside)
    b.rename(a)
    aside.rename(b)


def _keep(kept: Sequence[int], folder: Path) -> None:
    """Rewrite the chain with some of its lines."""
    path = folder / CHAIN_FILE
    lines = path.read_text().splitlines(keepends=True)
    path.write_text(''.join(lines[k] for k in kept))


def _end(names: Sequence[str], kept: int, folder: Path) -> None:
    """Remove the last entries of the chain with their records."""
    _keep(range(kept), folder)
    for name in names[kept:]:
        shutil.rmtree(folder / name)
