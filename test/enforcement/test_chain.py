# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""One canonical text per seal, and valid signatures."""
from __future__ import annotations

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.enforcement.chain import (
    entry_after, head_of, load_private_key, load_public_key, public_hex, RECORD, seal_of,
    write_key)

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
PUBLIC = public_hex(KEY.public_key())


@pytest.mark.parametrize('key', [None, KEY], ids=['unsigned', 'signed'])
def test_every_changed_byte_of_a_line_is_detected(key):
    seal = entry_after([], RECORD, 'run-000001', '0f' * 32, key)
    line = seal.line
    assert seal_of(line) == seal
    for at in range(len(line)):
        for other in (chr(ord(line[at]) ^ 1), chr(ord(line[at]) ^ 32), ' '):
            changed = seal_of(line[:at] + other + line[at + 1:])
            if other == line[at] or changed is None:
                continue
            # a line that is still a seal differs, and its signature is invalid
            assert changed.sha256 != seal.sha256
            assert key is None or changed.fault([PUBLIC])


def test_signature_must_be_of_a_trusted_key():
    seal = entry_after([], RECORD, 'a', '00' * 32, KEY)
    assert seal.fault([]) == seal.fault([PUBLIC]) == ''
    assert 'another key' in seal.fault(['00' * 32])
    assert 'not signed' in entry_after([], RECORD, 'a', '00' * 32, None).fault([PUBLIC])
    # against the library by itself
    KEY.public_key().verify(bytes.fromhex(seal.signature), seal._signed_text())


def test_entries_are_chained_to_the_previous_one():
    first = entry_after([], RECORD, 'a', '00' * 32, None)
    second = entry_after([first], RECORD, 'b', '11' * 32, None)
    assert (first.number, first.previous) == (1, '0' * 64)
    assert (second.number, second.previous) == (2, first.sha256)
    assert head_of([first, second], None).record_sha256 == second.sha256


def test_keys_are_read_back(tmp_path):
    public = write_key(tmp_path / 'k')
    assert (tmp_path / 'k').stat().st_mode & 0o777 == 0o600
    key = load_private_key(tmp_path / 'k')
    assert load_public_key(public) == public_hex(key.public_key())
    with pytest.raises(InputError, match='k: key: found File exists, wanted a new file'):
        write_key(tmp_path / 'k')
    for load, name in ((load_private_key, 'k.pub'), (load_public_key, 'k'),
                       (load_private_key, 'none')):
        with pytest.raises(InputError, match=f'{name}: key: found .*wanted an Ed25519'):
            load(tmp_path / name)
