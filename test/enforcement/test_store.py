# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Records are complete or absent, whatever the disk does and wherever the writer stops."""
from __future__ import annotations

import errno
import multiprocessing
import os
from pathlib import Path
import signal

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.enforcement import store as module
from stereo_speed.enforcement.store import EvidenceStore, StoreError
from stereo_speed.enforcement.verify import verify

DAY_NS = 86_400 * 10 ** 9
STEPS = 24  # steps of writing a small record, at each of which the disk may fill up


class Steps:
    """
    Counts the steps at which bytes or names go to the disk, and acts at one of them.

    :param at: number of the step.
    :param act: called at the step.
    """

    def __init__(self, monkeypatch, at, act):
        self.seen, self.at, self.act = 0, at, act
        for owner, name in ((os, 'fsync'), (os, 'rename'), (os, 'replace'), (Path, 'open')):
            monkeypatch.setattr(owner, name, self.wrapped(getattr(owner, name)))

    def wrapped(self, real):
        def call(*args, **kwargs):
            self.seen += 1
            if self.seen == self.at:
                self.act()
            return real(*args, **kwargs)
        return call


def full():
    """Fail like a full disk."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def names(folder):
    """Return the names of the records in a folder."""
    return sorted(p.name for p in folder.iterdir() if p.is_dir())


@pytest.mark.slow
@pytest.mark.parametrize('at', range(1, STEPS))
def test_disk_full_at_any_step_leaves_no_partial_record(tmp_path, small, monkeypatch, at):
    folder = tmp_path / 'evidence'
    with EvidenceStore(folder) as store:
        store.add('r1', *small('r1', 1))
        with monkeypatch.context() as patch:
            steps = Steps(patch, at, full)
            try:
                stored = store.add('r2', *small('r2', 2)) is not None
            except StoreError as error:
                stored = False
                assert 'No space left on device' in str(error)
        assert steps.seen >= at or stored
        assert names(folder) == ['r1', 'r2'][:1 + stored]
        assert verify(folder).sound, verify(folder).faults
        number = store.next_number
        store.add('r3', *small('r3', number))
    found = verify(folder)
    assert found.sound and found.records == number and not found.faults
    assert len(list(folder.glob('.*'))) == 0


def write_until_killed(folder, records, at):
    """Write records, and end the process at a step without cleaning up."""
    patch = pytest.MonkeyPatch()
    with EvidenceStore(folder) as store:
        Steps(patch, at, lambda: os.kill(os.getpid(), signal.SIGKILL))
        for name, (files, record) in records.items():
            store.add(name, files, record)
            Path(folder.parent, 'finished').write_text(name)


@pytest.mark.parametrize('at', [1, 2, 5, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 21, 30])
def test_writer_killed_at_any_step_loses_no_finished_record(tmp_path, small, at):
    folder = tmp_path / 'evidence'
    records = {f'r{k}': small(f'r{k}', k) for k in (1, 2, 3)}
    with EvidenceStore(folder):
        pass
    process = multiprocessing.get_context('fork').Process(
        target=write_until_killed, args=(folder, records, at))
    process.start()
    process.join(60)
    assert process.exitcode == -signal.SIGKILL
    assert verify(folder).sound, verify(folder).faults  # before the next start as well
    finished = Path(tmp_path, 'finished')
    last = int(finished.read_text()[1:]) if finished.exists() else 0
    with EvidenceStore(folder) as store:
        assert len(store.chain) in (last, last + 1)
        number = store.next_number
        store.add('after', *small('after', number))
    found = verify(folder)
    assert found.sound and found.records == number
    assert names(folder) == sorted([*(f'r{k}' for k in range(1, number)), 'after'])


def test_only_one_writer_is_allowed(tmp_path):
    with EvidenceStore(tmp_path):
        with pytest.raises(InputError, match='another program that writes to it, wanted one'):
            EvidenceStore(tmp_path)
    EvidenceStore(tmp_path).close()


def test_no_record_is_written_without_space(tmp_path, small, monkeypatch):
    monkeypatch.setattr(module.shutil, 'disk_usage',
                        lambda path: os.terminal_size((1, 1)) and type('D', (), {'free': 99}))
    with EvidenceStore(tmp_path, least_free_mib=1) as store:
        with pytest.raises(StoreError, match='free space: found 0 MiB, wanted 1 MiB'):
            store.add('r1', *small('r1', 1))
        assert store.chain == []


def test_rejected_record_leaves_nothing(tmp_path, small):
    with EvidenceStore(tmp_path) as store:
        assert store.add('r1', *small('r1', 1), accept=lambda folder: False) is None
        assert names(tmp_path) == [] and store.chain == []
        store.add('r1', *small('r1', 1))
        with pytest.raises(StoreError, match='r1 in the chain already'):
            store.add('r1', *small('r1', 2))


def test_damaged_chain_is_not_extended(tmp_path, small):
    with EvidenceStore(tmp_path) as store:
        for k in (1, 2):
            store.add(f'r{k}', *small(f'r{k}', k))
    chain = tmp_path / 'chain.jsonl'
    text = chain.read_text()
    for spoilt, wanted in ((text.replace('r1', 'x1'), 'entry 2'),
                           (text.splitlines()[0] + '\n', 'does not match its head')):
        chain.write_text(spoilt)
        with pytest.raises(InputError, match=wanted):
            EvidenceStore(tmp_path)
    chain.write_text(text)
    EvidenceStore(tmp_path).close()


def test_signed_chain_is_not_extended_without_a_key(tmp_path, small):
    with EvidenceStore(tmp_path, key=Ed25519PrivateKey.generate()) as store:
        store.add('r1', *small('r1', 1))
    with pytest.raises(InputError, match='signed but no key was given'):
        EvidenceStore(tmp_path)


def test_expired_records_are_deleted(tmp_path, small):
    with EvidenceStore(tmp_path) as store:
        for k, day in enumerate((9, 0, 5), 1):
            store.add(f'r{k}', *small(f'r{k}', k, last_ns=day * DAY_NS))
        assert store.delete_older(10 * DAY_NS, 0) == []
        assert store.delete_older(10 * DAY_NS, 7) == ['r2']
        assert names(tmp_path) == ['r1', 'r3'] and store.find('r2') is None
        store.add('r4', *small('r4', 5, last_ns=6 * DAY_NS))
    with EvidenceStore(tmp_path) as store:  # those of an earlier writer too
        assert store.delete_older(14 * DAY_NS, 7) == ['r3', 'r4']
    found = verify(tmp_path)
    assert found.sound and found.records == 1
    assert '"kind":"deleted"' in (tmp_path / 'chain.jsonl').read_text()
    # removed without an entry it counts as missing
    module.shutil.rmtree(tmp_path / 'r1')
    assert verify(tmp_path).faults == ['r1 is missing']


def test_unreadable_record_does_not_block_the_deletion_of_others(tmp_path, small):
    with EvidenceStore(tmp_path) as store:
        for k in (1, 2):
            store.add(f'r{k}', *small(f'r{k}', k, last_ns=0))
    (tmp_path / 'r1' / 'record.json').write_text('{')
    with EvidenceStore(tmp_path) as store:
        with pytest.raises(InputError, match='r1'):
            store.delete_older(10 * DAY_NS, 1)
        assert names(tmp_path) == ['r1']


def test_interrupted_deletion_is_completed(tmp_path, small, monkeypatch):
    with EvidenceStore(tmp_path) as store:
        store.add('r1', *small('r1', 1, last_ns=0))
        with monkeypatch.context() as patch:
            patch.setattr(module.shutil, 'rmtree', lambda *_, **__: full())
            with pytest.raises(StoreError, match='deletion'):
                store.delete_older(10 * DAY_NS, 1)
    assert any('deletion unfinished' in note for note in verify(tmp_path).notes)
    with EvidenceStore(tmp_path):
        assert names(tmp_path) == []
    assert verify(tmp_path).sound


def test_chain_of_records_of_random_sizes_is_valid(tmp_path, small):
    rng = np.random.default_rng(2)
    with EvidenceStore(tmp_path) as store:
        for k in range(1, 6):
            store.add(f'r{k}', *small(f'r{k}', k, size=int(rng.integers(1, 200))))
    assert verify(tmp_path).sound
