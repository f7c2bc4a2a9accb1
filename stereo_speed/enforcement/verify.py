# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Verify records: find what was changed, lost, added, moved or cut since they were written."""
from __future__ import annotations

from dataclasses import dataclass, field
import json
import os
from pathlib import Path
from typing import Any, Iterator, Mapping, Optional, Sequence

from .chain import DELETED, follows, HEAD, RECORD, Seal, seal_of, tip
from .fingerprint import sha256
from .schema import schema_fault
from ..core.errors import InputError

RECORD_FILE, SEAL_FILE, CHAIN_FILE, HEAD_FILE = (
    'record.json', 'seal.json', 'chain.jsonl', 'head.json')
PARTIAL = '.partial-'  # prefix of names that are still being written


@dataclass
class Verification:
    """
    The result of verifying records.

    :param faults: a line for each part that is not as it was written; empty where all is sound.
    :param notes: further information for the reader.
    :param records: number of records verified.
    :param keys: public keys of the signers, hex.
    """

    faults: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    records: int = 0
    keys: set[str] = field(default_factory=set)

    @property
    def sound(self) -> bool:
        """Return whether there are no faults."""
        return not self.faults


def verify(folder: Path, head: Optional[Path] = None, trusted: Sequence[str] = ()
           ) -> Verification:
    """
    Verify a folder of records, or one record.

    :param folder: folder of all records with their chain, or of one record.
    :param head: separate file of the chain's head; None for the one beside the chain.
    :param trusted: public keys, hex; everything must be signed by one of them. If empty,
        signatures are checked with the keys that they name.
    :raises InputError: no such folder, or one without records.
    """
    if not folder.is_dir():
        raise InputError(folder, 'evidence', 'no such folder', 'a folder of records, or of one')
    if _is_record(folder):
        return _verify_one(folder, trusted)
    if not (folder / CHAIN_FILE).exists() and not (folder / HEAD_FILE).exists() \
            and not any(_is_record(p) for p in folder.iterdir() if p.is_dir()):
        raise InputError(folder, 'evidence', 'neither a chain nor a record',
                         'a folder of records, or of one')
    return _verify_all(folder, head, trusted)


def _verify_one(folder: Path, trusted: Sequence[str]) -> Verification:
    """Verify a single record."""
    out = Verification(records=1)
    seal = check_record(folder, folder.resolve().name, out.faults)
    if seal is not None:
        _check_signature(seal, f'{folder.name}/{SEAL_FILE}', trusted, out)
    out.notes.append('a single record: whether others are missing cannot be checked')
    return out


def _verify_all(folder: Path, head: Optional[Path], trusted: Sequence[str]) -> Verification:
    out = Verification()
    chain = read_chain(folder / CHAIN_FILE, out.faults)
    signed = False
    for seal in chain:
        where = f'{CHAIN_FILE}: entry {seal.number} ({seal.record_id})'
        _check_signature(seal, where, trusted, out)
        if signed and not seal.key:
            out.faults.append(f'{where} is not signed, although earlier entries are')
        signed |= bool(seal.key)
    _check_head(folder, head, chain, trusted, out)
    files = (CHAIN_FILE, HEAD_FILE) if head is None else (CHAIN_FILE,)
    _check_folders(folder, files, chain, trusted, out)
    if head is None:
        out.notes.append(f'{HEAD_FILE} is stored beside the records: replacement of the folder '
                         'by an older copy cannot be detected')
    if not signed:
        out.notes.append('nothing is signed: anyone who can write to the folder can forge it')
    elif not trusted:
        out.notes.append('signatures were checked only against the keys that the records name: '
                         'give the public key that you trust')
    return out


def _text_of(path: Path, name: str, faults: list[str]) -> Optional[str]:
    """Return the text of a file; None, and add a fault, where it cannot be read."""
    try:
        return path.read_bytes().decode('utf-8')
    except FileNotFoundError:
        faults.append(f'{name} is missing')
    except (OSError, UnicodeDecodeError) as error:
        faults.append(f'{name} was changed: {error}')
    return None


def _seal_in(path: Path, name: str, kind: str, faults: list[str]) -> Optional[Seal]:
    """Return the seal of a file; None, and add a fault, where it has none of the kind."""
    text = _text_of(path, name, faults)
    if text is None:
        return None
    seal = seal_of(text[:-1]) if text.endswith('\n') else None
    if seal is None or seal.kind != kind or kind == HEAD and (seal.record_id or seal.previous):
        faults.append(f'{name} was changed')
        return None
    return seal


def read_chain(path: Path, faults: list[str]) -> list[Seal]:
    """
    Read the seals of a chain, up to the first invalid line.

    :param path: path of the file.
    :param faults: list to which a line is appended for each fault.
    """
    text = _text_of(path, path.name, faults)
    if text is None:
        return []
    chain: list[Seal] = []
    if text and not text.endswith('\n'):
        faults.append(f'{path.name} ends in an incomplete line')
    for number, line in enumerate(text.split('\n')[:-1], 1):
        seal = seal_of(line)
        if seal is None:
            faults.append(f'{path.name}: entry {number} was changed')
            return chain
        if not follows(seal, chain):
            faults.append(f'{path.name}: entry {number} ({seal.record_id}) does not follow the '
                          'previous one: entries are missing, added or reordered')
        chain.append(seal)
    return chain


def _check_signature(seal: Seal, where: str, trusted: Sequence[str], out: Verification) -> None:
    fault = seal.fault(trusted)
    if fault:
        out.faults.append(f'{where} {fault}')
    elif seal.key:
        out.keys.add(seal.key)


def _check_head(folder: Path, apart: Optional[Path], chain: Sequence[Seal],
                trusted: Sequence[str], out: Verification) -> None:
    """Check the chain against its head."""
    path = folder / HEAD_FILE if apart is None else apart
    head = read_head(path, out.faults)
    if head is None:
        return
    _check_signature(head, path.name, trusted, out)
    if chain and chain[-1].key and not head.key:
        out.faults.append(f'{path.name} is not signed, although the chain is')
    if head.number == len(chain) - 1 and head.record_sha256 == chain[-1].previous:
        out.notes.append(f'{path.name} lacks the last entry: the writer stopped before it was '
                         'updated; the next start of the writer repairs it')
    elif head.number > len(chain):
        out.faults.append(f'{CHAIN_FILE} was cut: it has {len(chain)} of the {head.number} '
                          f'entries in {path.name}')
    elif head.number < len(chain):
        out.faults.append(f'{CHAIN_FILE} has {len(chain)} entries, but {path.name} '
                          f'counts {head.number}')
    elif head.record_sha256 != tip(chain):
        out.faults.append(f'{CHAIN_FILE} does not match {path.name}: entries were replaced')


def read_head(path: Path, faults: list[str]) -> Optional[Seal]:
    """
    Read the head of a chain; None where it is invalid.

    :param path: path of the file.
    :param faults: list to which a line is appended for each fault.
    """
    return _seal_in(path, path.name, HEAD, faults)


def _check_folders(folder: Path, files: Sequence[str], chain: Sequence[Seal],
                   trusted: Sequence[str], out: Verification) -> None:
    """Check the folders of records against the chain."""
    deleted = {seal.record_id for seal in chain if seal.kind == DELETED}
    records = {seal.record_id: seal for seal in chain if seal.kind == RECORD}
    if len(records) + len([s for s in chain if s.kind == DELETED]) != len(chain):
        out.faults.append(f'{CHAIN_FILE}: an entry of unknown kind, or a record listed twice')
    present = {p.name for p in folder.iterdir()}
    for record_id, seal in records.items():
        if record_id in deleted:
            if record_id in present:
                out.notes.append(f'{record_id}: deletion unfinished; the next start of the '
                                 'writer completes it')
            continue
        out.records += 1
        if not (folder / record_id).is_dir():
            out.faults.append(f'{record_id} is missing')
            continue
        own = check_record(folder / record_id, record_id, out.faults)
        if own is not None and own != seal:
            out.faults.append(f'{record_id}/{SEAL_FILE} differs from its entry in the chain')
    for record_id in sorted(deleted - set(records)):
        out.faults.append(f'{CHAIN_FILE}: {record_id} was deleted but never written')
    for name in sorted(present - set(records) - set(files)):
        _check_stranger(folder / name, chain, trusted, out)


def _check_stranger(path: Path, chain: Sequence[Seal], trusted: Sequence[str],
                    out: Verification) -> None:
    """Check a file or folder that is not in the chain."""
    if path.name.startswith(PARTIAL):
        out.notes.append(f'{path.name} is unfinished and not a record')
        return
    faults: list[str] = []
    seal = check_record(path, path.name, faults) if path.is_dir() else None
    if not faults and seal is not None and follows(seal, chain) and not seal.fault(trusted):
        out.records += 1
        out.notes.append(f'{path.name} is complete but not in the chain yet: the writer stopped '
                         'before; its next start adds it')
        return
    out.faults.append(f'{path.name} was added')


def check_record(folder: Path, record_id: str, faults: list[str]) -> Optional[Seal]:
    """
    Check the files of a record; return its seal, or None where that is invalid.

    :param folder: folder of the record.
    :param record_id: its expected id.
    :param faults: list to which a line is appended for each fault.
    """
    name = folder.name
    seal = _seal_in(folder / SEAL_FILE, f'{name}/{SEAL_FILE}', RECORD, faults)
    if seal is not None and seal.record_id != record_id:
        faults.append(f'{name}/{SEAL_FILE} is the seal of record {seal.record_id}')
    try:
        data = (folder / RECORD_FILE).read_bytes()
    except OSError:
        faults.append(f'{name}/{RECORD_FILE} is missing')
        return seal
    if seal is not None and sha256(data) != seal.record_sha256:
        faults.append(f'{name}/{RECORD_FILE} was changed')
    record = _parsed(data)
    fault = 'no JSON' if record is None else schema_fault(record)
    if record is None or fault:
        faults.append(f'{name}/{RECORD_FILE} is not a valid record: {fault}')
        return seal
    if record['id'] != record_id:
        faults.append(f'{name} contains record {record["id"]}')
    faults += [f'{name}/{fault}' for fault in _file_faults(folder, record['files'])]
    return seal


def _parsed(data: bytes) -> Optional[dict[str, Any]]:
    try:
        record = json.loads(data.decode('utf-8'))
    except ValueError:
        return None
    return record if isinstance(record, dict) else None


def _file_faults(folder: Path, listed: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Yield the faults of the files of a record."""
    found = {p.relative_to(folder).as_posix() for p in folder.rglob('*')
             if p.is_symlink() or not p.is_dir()} - {RECORD_FILE, SEAL_FILE}
    folders = {os.path.dirname(name) for name in (*listed, *found)}
    for path in folder.rglob('*'):
        name = path.relative_to(folder).as_posix()
        if path.is_dir() and not any(f == name or f.startswith(f'{name}/') for f in folders):
            yield f'{name}/ was added'
    for name in sorted(found - set(listed)):
        yield f'{name} was added'
    for name in sorted(listed):
        path = folder / name
        if name not in found:
            yield f'{name} is missing'
        elif path.is_symlink() or not path.is_file() or sha256(path.read_bytes()) != \
                listed[name]['sha256']:
            yield f'{name} was changed'


def _is_record(path: Path) -> bool:
    return (path / RECORD_FILE).exists() or (path / SEAL_FILE).exists()
