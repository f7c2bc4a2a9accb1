# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Every change, removal, addition, move and truncation is detected and named."""
from __future__ import annotations

import json
import os
from pathlib import Path
import shutil

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.enforcement.chain import public_hex
from stereo_speed.enforcement.store import EvidenceStore
from stereo_speed.enforcement.verify import verify

from .conftest import NAME

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
TRUSTED = [public_hex(KEY.public_key())]
POSITIONS = 60  # bytes of each file that are flipped; ``tamper`` flips any number


@pytest.fixture(params=[None, KEY], ids=['unsigned', 'signed'])
def three(request, tmp_path, small):
    """Return a folder of three small records, and the trusted keys."""
    with EvidenceStore(tmp_path / 'evidence', key=request.param) as store:
        for number in (1, 2, 3):
            store.add(f'r{number}', *small(f'r{number}', number))
    return tmp_path / 'evidence', TRUSTED if request.param else []


def faults(folder, trusted=()):
    """Return the faults as one text."""
    found = verify(folder, trusted=trusted)
    assert found.sound == (not found.faults)
    return '; '.join(found.faults)


def test_unchanged_records_are_valid(three, written):
    folder, trusted = three
    assert faults(folder, trusted) == faults(written) == faults(written / NAME) == ''
    assert verify(folder).records == 3
    assert any('nothing is signed' in note for note in verify(written).notes)


@pytest.mark.slow
def test_every_byte_of_small_records_counts(three):
    """All bytes of chain, head and a seal, and a sample of those of the record."""
    folder, trusted = three
    rng = np.random.default_rng(1)
    for path in [*folder.glob('*.json*'), folder / 'r3' / 'seal.json',
                 folder / 'r2' / 'record.json']:
        data = path.read_bytes()
        for at in rng.permutation(len(data))[:POSITIONS]:
            path.write_bytes(data[:at] + bytes([data[at] ^ 1 << int(rng.integers(8))])
                             + data[at + 1:])
            found = faults(folder, trusted)
            assert path.name in found, (path, at)
        path.write_bytes(data)
    assert faults(folder, trusted) == ''


@pytest.mark.slow
def test_each_file_of_a_real_record_counts(evidence):
    for path in [p for p in evidence.rglob('*') if p.is_file()]:
        data = path.read_bytes()
        at = len(data) // 2
        for spoilt in (data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1:], data[:-1],
                       data + b'\n', b''):
            path.write_bytes(spoilt)
            assert path.name in faults(evidence)
        path.unlink()
        assert f'{path.name} is missing' in faults(evidence)
        path.write_bytes(data)
    assert faults(evidence) == ''


def test_removed_added_or_moved_files_are_named(three):
    folder, trusted = three

    def spoilt(*steps, wanted):
        copy = Path(shutil.copytree(folder, folder.parent / 'copy'))
        for step in steps:
            step(copy)
        assert wanted in faults(copy, trusted)
        shutil.rmtree(copy)
    for name in ('r1', 'r2', 'r3'):
        spoilt(lambda d: shutil.rmtree(d / name), wanted=f'{name} is missing')
    spoilt(lambda d: (d / 'r1/extra.txt').write_text('x'), wanted='r1/extra.txt was added')
    spoilt(lambda d: (d / 'r1/sub/deep').mkdir(), wanted='r1/sub/deep/ was added')
    spoilt(lambda d: (d / 'notes.txt').write_text('x'), wanted='notes.txt was added')
    spoilt(lambda d: shutil.copytree(d / 'r1', d / 'r9'), wanted='r9 was added')
    spoilt(lambda d: (d / 'r1/a.txt').rename(d / 'r1/c.txt'), wanted='r1/a.txt is missing')
    spoilt(lambda d: (d / 'r1').rename(d / 't'), lambda d: (d / 'r2').rename(d / 'r1'),
           lambda d: (d / 't').rename(d / 'r2'), wanted='r1/seal.json is the seal of record r2')
    spoilt(lambda d: (d / 'r1/a.txt').unlink(),
           lambda d: (d / 'r1/a.txt').symlink_to(d / 'r2/a.txt'), wanted='r1/a.txt was changed')
    spoilt(lambda d: (d / 'chain.jsonl').unlink(), wanted='chain.jsonl is missing')
    spoilt(lambda d: (d / 'head.json').unlink(), wanted='head.json is missing')


def test_truncated_or_reordered_chain_is_found(three):
    folder, trusted = three
    path = folder / 'chain.jsonl'
    lines = path.read_text().splitlines(keepends=True)
    for kept, wanted in (([0, 1], 'was cut: it has 2 of the 3 entries'), ([], 'was cut'),
                         ([0, 2], 'entry 2 (r3) does not follow'),
                         ([1, 0, 2], 'entry 1 (r2) does not follow'),
                         ([0, 1, 2, 2], 'entry 4 (r3) does not follow')):
        path.write_text(''.join(lines[k] for k in kept))
        assert wanted in faults(folder, trusted)
    path.write_text(''.join(lines)[:-40])
    assert 'ends in an incomplete line' in faults(folder, trusted)
    # chain and last record removed together
    path.write_text(''.join(lines[:2]))
    shutil.rmtree(folder / 'r3')
    assert 'was cut: it has 2 of the 3 entries' in faults(folder, trusted)


def test_separately_kept_head_reveals_an_older_copy(tmp_path, small):
    head = tmp_path / 'apart' / 'head.json'
    with EvidenceStore(tmp_path / 'evidence', head) as store:
        store.add('r1', *small('r1', 1))
        older = shutil.copytree(tmp_path / 'evidence', tmp_path / 'older')
        store.add('r2', *small('r2', 2))
        store.add('r3', *small('r3', 3))
    assert verify(tmp_path / 'evidence', head).sound
    assert 'was cut: it has 1 of the 3 entries' in '; '.join(verify(Path(older), head).faults)


def test_recreated_records_are_found_by_their_signature(three, small):
    """Without the key one can recompute all hashes, but not the signatures."""
    folder, trusted = three
    if not trusted:
        return
    shutil.rmtree(folder)
    with EvidenceStore(folder, key=Ed25519PrivateKey.generate()) as store:
        for number in (1, 2, 3):
            store.add(f'r{number}', *small(f'r{number}', number, size=41))
    assert faults(folder) == ''
    found = faults(folder, trusted)
    assert 'entry 1 (r1) is signed by another key' in found
    assert 'head.json is signed by another key' in found


def test_folder_without_evidence_is_bad_input(tmp_path):
    (tmp_path / 'empty').mkdir()
    for folder in (tmp_path / 'none', tmp_path / 'empty'):
        with pytest.raises(InputError, match='evidence: found .*wanted a folder of records'):
            verify(folder)


def test_record_may_not_refer_outside_its_folder(evidence):
    path = evidence / NAME / 'record.json'
    record = json.loads(path.read_text())
    record['files']['../../x'] = {'sha256': '0' * 64, 'bytes': 1}
    path.write_text(json.dumps(record))
    assert 'is not a valid record' in faults(evidence)
    assert os.path.exists(path)
