# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The folder of records, which holds only complete ones: synced, sealed and chained.

A record is written to a temporary folder, synced, sealed and only then moved to its name; then the
chain gets its entry, then the head. If a writer stops at any step, the next start recovers:
records that were moved are entered in the chain, others are removed.
"""
from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
import fcntl
import json
import logging
import os
from pathlib import Path
import shutil
from typing import Callable, Mapping, Optional, Union

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from .chain import DELETED, entry_after, follows, head_of, RECORD, Seal, tip
from .fingerprint import sha256
from .verify import (
    CHAIN_FILE, check_record, HEAD_FILE, PARTIAL, read_chain, read_head, RECORD_FILE, SEAL_FILE)
from ..core.errors import InputError, StereoSpeedError
from ..io.atomic import prepare_folder

_log = logging.getLogger(__name__)
_MIB = 1 << 20
_DAY_NS = 86_400 * 1_000_000_000
Files = Mapping[str, bytes]


class StoreError(StereoSpeedError):
    """A record could not be written; no part of it remains."""


@dataclass(frozen=True)
class Stored:
    """
    A record that is in the store.

    :param folder: folder of the record.
    :param seal: seal of the record.
    :param anew: whether it was written now; False where it existed already.
    """

    folder: Path
    seal: Seal
    anew: bool


class EvidenceStore(AbstractContextManager['EvidenceStore']):
    """
    A folder of records, for one writer at a time; a context manager.

    :param folder: the folder, made where it is missing.
    :param head: separate file for the chain's head; None for one beside the chain.
    :param key: private key for signing; None leaves records unsigned.
    :param least_free_mib: free disk space below which no record is started.
    :raises InputError: the folder cannot be written, another program writes to it, or its chain
        does not verify.
    """

    def __init__(self, folder: Union[str, Path], head: Optional[Path] = None,
                 key: Optional[Ed25519PrivateKey] = None, least_free_mib: int = 0) -> None:
        self.folder = prepare_folder(folder)
        self.head_path = self.folder / HEAD_FILE if head is None else head
        prepare_folder(self.head_path.parent)
        self._key, self._least_free_mib = key, least_free_mib
        self._head_is_behind = False
        self._stamps_ns: dict[str, int] = {}
        self._lock = os.open(self.folder, os.O_RDONLY)
        try:
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(self.folder, 'evidence', 'another program that writes to it',
                                 'one writer') from None
            self.chain = self._recovered()
            self._entries = {seal.record_id: seal for seal in self.chain}  # the last one counts
        except BaseException:
            os.close(self._lock)
            raise

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the lock, so that others may write."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    @property
    def next_number(self) -> int:
        """Return the number of the next entry."""
        return len(self.chain) + 1

    def find(self, record_id: str) -> Optional[Seal]:
        """Return the entry of a record; None where it does not exist or was deleted."""
        seal = self._entries.get(record_id)
        return seal if seal is not None and seal.kind == RECORD else None

    def add(self, record_id: str, files: Files, record: bytes,
            accept: Callable[[Path], bool] = lambda folder: True) -> Optional[Stored]:
        """
        Write a record, completely or not at all.

        :param record_id: name of its folder.
        :param files: contents by name, without ``record.json``.
        :param record: the bytes of ``record.json``.
        :param accept: checks the folder before it is sealed; a record that it refuses is removed.
        :return: the record; None where it was refused.
        :raises StoreError: the disk is full or fails.
        """
        if record_id in self._entries:
            raise StoreError(f'{self.folder}: record: found {record_id} in the chain already, '
                             'wanted a new name')
        self._check_space(sum(map(len, files.values())) + len(record))
        stage = self.folder / f'{PARTIAL}{record_id}'
        try:
            self._tell_head()
            for name, data in {**files, RECORD_FILE: record}.items():
                _write_synced(stage / name, data)
            if not accept(stage):
                return None
            seal = entry_after(self.chain, RECORD, record_id, sha256(record), self._key)
            _write_synced(stage / SEAL_FILE, f'{seal.line}\n'.encode())
            for path in (stage, *(p for p in stage.rglob('*') if p.is_dir())):
                _sync_folder(path)
            os.rename(stage, self.folder / record_id)
            _sync_folder(self.folder)
            self._enter(seal)
        except OSError as error:
            shutil.rmtree(self.folder / record_id, ignore_errors=True)
            raise StoreError(f'{error.filename or self.folder}: record {record_id}: found '
                             f'{error.strerror or error}, wanted a place that can be written'
                             ) from None
        finally:
            shutil.rmtree(stage, ignore_errors=True)
        return Stored(self.folder / record_id, seal, anew=True)

    def delete_older(self, now_ns: int, days: int) -> list[str]:
        """
        Delete expired records; the chain keeps their seals and gets entries of the deletions.

        :param now_ns: the present time.
        :param days: age up to which records are kept; 0 keeps all.
        :return: names of the deleted records, the oldest first.
        :raises InputError: the time of a record cannot be read.
        :raises StoreError: the disk fails.
        """
        gone: list[str] = []
        if not days:
            return gone
        dated, unreadable = self._dated()
        for stamp_ns, record_id in dated:
            seal = self._entries[record_id]
            if now_ns - stamp_ns <= days * _DAY_NS:
                break
            try:  # entry first: a record missing without one would count as removed
                self._enter(entry_after(self.chain, DELETED, record_id, seal.record_sha256,
                                        self._key))
                shutil.rmtree(self.folder / record_id)
            except OSError as error:
                raise StoreError(f'{self.folder / record_id}: deletion: found '
                                 f'{error.strerror or error}, wanted a folder that can be '
                                 'deleted') from None
            _log.info('deleted %s: older than %d days', record_id, days)
            gone.append(record_id)
        if unreadable is not None:  # raised only now, so that the others are deleted
            raise unreadable
        return gone

    def _dated(self) -> tuple[list[tuple[int, str]], Optional[InputError]]:
        """Return stamps and names of the records, oldest first, and the error of one without."""
        dated, unreadable = [], None
        for record_id, seal in self._entries.items():
            if seal.kind == RECORD:
                try:
                    dated.append((self._stamp_ns(record_id), record_id))
                except InputError as error:
                    unreadable = error
        return sorted(dated), unreadable

    def _stamp_ns(self, record_id: str) -> int:
        """Return the stamp of a record's last pair, ns; its file is read only once."""
        if record_id not in self._stamps_ns:
            path = self.folder / record_id / RECORD_FILE
            try:
                record = json.loads(path.read_text(encoding='utf-8'))
                self._stamps_ns[record_id] = int(record['time']['last_stamp_ns'])
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise InputError(path, 'record', error,
                                 "a record as it was written (see 'evidence verify')") from None
        return self._stamps_ns[record_id]

    # -- the chain ------------------------------------------------------------------------

    def _enter(self, seal: Seal) -> None:
        """Add an entry to the chain, then update the head."""
        chain, path = [*self.chain, seal], self.folder / CHAIN_FILE
        try:
            _replace_synced(path, _chain_text(chain))
        except OSError as error:
            if path.read_text(encoding='utf-8') != _chain_text(chain):
                raise
            # the new chain is in place already, so the entry must stay
            _log.error('%s: %s: not synced', path, error.strerror or error)
        self.chain, self._head_is_behind = chain, True
        self._entries[seal.record_id] = seal
        try:
            self._tell_head()
        except OSError as error:  # the entry stays; the head is updated before the next one
            _log.error('%s: %s: the head of the chain lacks entry %d', self.head_path,
                       error.strerror or error, len(chain))

    def _tell_head(self) -> None:
        """Write the head if it lacks the last entry."""
        if self._head_is_behind:
            _replace_synced(self.head_path, head_of(self.chain, self._key).line + '\n')
            self._head_is_behind = False

    def _check_space(self, size: int) -> None:
        free = shutil.disk_usage(self.folder).free
        wanted = self._least_free_mib * _MIB + size
        if free < wanted:
            raise StoreError(f'{self.folder}: free space: found {free / _MIB:.0f} MiB, wanted '
                             f'{wanted / _MIB:.0f} MiB for a record')

    # -- recovery -------------------------------------------------------------------------

    def _recovered(self) -> list[Seal]:
        """Return the chain, after completing the steps that a stopped writer left unfinished."""
        for path in (*self.folder.glob(f'{PARTIAL}*'),
                     *self.head_path.parent.glob(f'{PARTIAL}{self.head_path.name}')):
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        chain, faults = self._read()
        if faults:
            raise InputError(self.folder, 'evidence', '; '.join(faults),
                             "a sound chain (see 'evidence verify')")
        known = {seal.record_id for seal in chain}
        strange = [p for p in self.folder.iterdir() if p.is_dir() and p.name not in known]
        if len(strange) > 1:
            raise InputError(self.folder, 'folders', f'{len(strange)} that are not in the '
                             'chain', "records of the chain only (see 'evidence verify')")
        chain = [*chain, *(self._left_over(path, chain) for path in strange)]
        for seal in chain:
            if seal.kind == DELETED:
                shutil.rmtree(self.folder / seal.record_id, ignore_errors=True)
        _replace_synced(self.folder / CHAIN_FILE, _chain_text(chain))
        _replace_synced(self.head_path, head_of(chain, self._key).line + '\n')
        return chain

    def _read(self) -> tuple[list[Seal], list[str]]:
        """Return the chain and its faults; a head that is one entry behind is no fault."""
        faults: list[str] = []
        if not (self.folder / CHAIN_FILE).exists() and not self.head_path.exists():
            # stopped before its first entry
            return [], faults
        chain = read_chain(self.folder / CHAIN_FILE, faults)
        if not self.head_path.exists() and not chain and not faults:
            return [], faults  # stopped between writing the first, empty chain and its head
        head = read_head(self.head_path, faults)
        if head is not None and not faults:
            behind = len(chain) - head.number
            if behind not in (0, 1) or head.record_sha256 != tip(chain[:head.number]):
                faults.append(f'{CHAIN_FILE} does not match its head')
            own = None if self._key is None else head_of([], self._key).key
            if head.key and own is None:
                faults.append('the chain is signed but no key was given')
            elif head.key:
                fault = head.fault([])
                faults += [f'{self.head_path.name} {fault}'] if fault else []
        return chain, faults

    def _left_over(self, path: Path, chain: list[Seal]) -> Seal:
        """Return the seal of a complete record that was not yet entered in the chain."""
        faults: list[str] = []
        seal = check_record(path, path.name, faults)
        if seal is None or faults or not follows(seal, chain):
            raise InputError(path, 'folder', faults[0] if faults else 'not a record of this chain',
                             "records of the chain only (see 'evidence verify')")
        return seal


def _chain_text(chain: list[Seal]) -> str:
    return ''.join(f'{seal.line}\n' for seal in chain)


def _write_synced(path: Path, data: bytes) -> None:
    """Write a file and sync it to disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open('wb') as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())


def _replace_synced(path: Path, text: str) -> None:
    """Replace a file atomically and sync it to disk."""
    aside = path.with_name(f'{PARTIAL}{path.name}')
    try:
        _write_synced(aside, text.encode())
        os.replace(aside, path)
    except OSError:
        aside.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def _sync_folder(path: Path) -> None:
    """Sync the directory entries of a folder to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
