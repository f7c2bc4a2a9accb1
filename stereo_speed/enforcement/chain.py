# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Seals: the SHA-256 of each record, linked to the previous seal and signed with Ed25519.

A seal is one line of canonical JSON: each content has exactly one text, so that a change of any
byte is detected. The chain is the file of all seals. The head, stored separately, has their
number, so that truncation of the chain is detected.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import json
import os
from pathlib import Path
import re
from typing import Any, Mapping, Optional, Sequence, Union

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import (
    Ed25519PrivateKey, Ed25519PublicKey)

from .fingerprint import canonical, sha256
from ..core.errors import InputError

FORMAT = 1
NOTHING = '0' * 64  # the link of the first seal
RECORD, DELETED, HEAD = 'record', 'deleted', 'head'
_HEX = re.compile('[0-9a-f]*')
_FIELDS = ('format', 'kind', 'number', 'id', 'record_sha256', 'previous', 'key', 'signature')


@dataclass(frozen=True)
class Seal:
    """
    An entry of the chain, or its head.

    :param kind: ``record``, ``deleted`` (for a record that was deleted by age) or ``head``.
    :param number: number of the entry, from 1; for a head, that of the last entry.
    :param record_id: id of the record; empty for a head.
    :param record_sha256: SHA-256 of ``record.json``; for a head, of the last entry's line.
    :param previous: SHA-256 of the previous entry's line; empty for a head.
    :param key: public key of the signer, hex; empty where unsigned.
    :param signature: signature, hex; empty where unsigned.
    """

    kind: str
    number: int
    record_id: str
    record_sha256: str
    previous: str
    key: str = ''
    signature: str = ''

    @property
    def line(self) -> str:
        """Return the canonical text of the seal, without its line end."""
        return canonical({**self._content(), 'signature': self.signature})

    @property
    def sha256(self) -> str:
        """Return the SHA-256 of its line, to which the next entry is linked."""
        return sha256(self.line)

    def signed(self, key: Optional[Ed25519PrivateKey]) -> Seal:
        """Return the seal signed with a key; unchanged without one."""
        if key is None:
            return self
        bare = replace(self, key=public_hex(key.public_key()), signature='')
        return replace(bare, signature=key.sign(bare._signed_text()).hex())

    def fault(self, trusted: Sequence[str]) -> str:
        """
        Return what is wrong with the signature; empty where it is valid.

        :param trusted: public keys, hex; one of them must have signed. If empty, any valid
            signature passes, and so does an unsigned seal.
        """
        if not self.key and not self.signature:
            return 'is not signed' if trusted else ''
        if trusted and self.key not in trusted:
            return f'is signed by another key, {self.key[:16]}…'
        try:
            Ed25519PublicKey.from_public_bytes(bytes.fromhex(self.key)).verify(
                bytes.fromhex(self.signature), self._signed_text())
        except (InvalidSignature, ValueError):
            return 'has a signature that does not match its content'
        return ''

    def _signed_text(self) -> bytes:
        return canonical(self._content()).encode()

    def _content(self) -> dict[str, Any]:
        return {'format': FORMAT, 'kind': self.kind, 'number': self.number, 'id': self.record_id,
                'record_sha256': self.record_sha256, 'previous': self.previous, 'key': self.key}


def seal_of(line: str) -> Optional[Seal]:
    """Return the seal of a line; None where the line is not the canonical text of a seal."""
    try:
        data: Mapping[str, Any] = json.loads(line)
        if set(data) != set(_FIELDS) or data['format'] != FORMAT:
            return None
        seal = Seal(*(data[name] for name in _FIELDS[1:]))
        texts = (seal.kind, seal.record_id, seal.record_sha256, seal.previous, seal.key,
                 seal.signature)
        if not all(isinstance(text, str) for text in texts) or type(seal.number) is not int:
            return None
        # upper-case hex would give one content a second text
        if not all(_HEX.fullmatch(text) for text in texts[2:]):
            return None
        return seal if seal.line == line else None
    except (ValueError, TypeError, KeyError):
        return None


def tip(chain: Sequence[Seal]) -> str:
    """Return the SHA-256 to which the next entry of a chain is linked."""
    return chain[-1].sha256 if chain else NOTHING


def follows(seal: Seal, chain: Sequence[Seal]) -> bool:
    """Return whether a seal is the next entry of a chain."""
    return seal.number == len(chain) + 1 and seal.previous == tip(chain)


def head_of(chain: Sequence[Seal], key: Optional[Ed25519PrivateKey]) -> Seal:
    """Return the head of a chain, signed if a key is given."""
    return Seal(HEAD, len(chain), '', tip(chain), '').signed(key)


def entry_after(chain: Sequence[Seal], kind: str, record_id: str, record_sha256: str,
                key: Optional[Ed25519PrivateKey]) -> Seal:
    """Return the next entry of a chain, for a record or its deletion."""
    return Seal(kind, len(chain) + 1, record_id, record_sha256, tip(chain)).signed(key)


def public_hex(key: Ed25519PublicKey) -> str:
    """Return a public key as hex."""
    return key.public_bytes(serialization.Encoding.Raw,
                            serialization.PublicFormat.Raw).hex()


def load_private_key(path: Union[str, Path]) -> Ed25519PrivateKey:
    """
    Read a private key for signing: Ed25519, PEM (PKCS 8), without a password.

    :raises InputError: the file is no such key.
    """
    wanted = 'an Ed25519 private key in PEM, without a password'
    try:
        key = serialization.load_pem_private_key(Path(path).read_bytes(), None)
    except OSError as error:
        raise InputError(path, 'key', error.strerror or error, wanted) from None
    except (ValueError, TypeError) as error:
        raise InputError(path, 'key', str(error).split('.')[0] or 'no key', wanted) from None
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(path, 'key', type(key).__name__, wanted)
    return key


def load_public_key(path: Union[str, Path]) -> str:
    """
    Read a public key for verification: Ed25519, PEM.

    :return: the key, hex.
    :raises InputError: the file is no such key.
    """
    wanted = 'an Ed25519 public key in PEM'
    try:
        key = serialization.load_pem_public_key(Path(path).read_bytes())
    except OSError as error:
        raise InputError(path, 'key', error.strerror or error, wanted) from None
    except ValueError as error:
        raise InputError(path, 'key', str(error).split('.')[0] or 'no key', wanted) from None
    if not isinstance(key, Ed25519PublicKey):
        raise InputError(path, 'key', type(key).__name__, wanted)
    return public_hex(key)


def write_key(path: Path) -> Path:
    """
    Write a new private key, PEM, readable by its owner only, and the public key beside it.

    :param path: a new file.
    :return: the file of the public key.
    :raises InputError: a file exists already, or cannot be written.
    """
    key, beside = Ed25519PrivateKey.generate(), public_of(path)
    private = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8,
                                serialization.NoEncryption())
    public = key.public_key().public_bytes(
        serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    for new, data, mode in ((path, private, 0o600), (beside, public, 0o644)):
        try:
            descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        except OSError as error:
            raise InputError(new, 'key', error.strerror, 'a new file') from None
        with os.fdopen(descriptor, 'wb') as stream:
            stream.write(data)
    return beside


def public_of(key: Path) -> Path:
    """Return the path of the public key beside a private key."""
    return key.with_name(key.name + '.pub')
