# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Seals: each record's SHA-256, tied to the seal before it and signed with Ed25519.

A seal is one line of canonical JSON; there is one text for one content, so that no byte of it
can change unseen. The chain is the file of all seals; the head, kept apart, says how many there
are, so that the last ones cannot be cut off unseen.
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
NOTHING = '0' * 64  # what the first seal is tied to
RECORD, DELETED, HEAD = 'record', 'deleted', 'head'
_HEX = re.compile('[0-9a-f]*')
_FIELDS = ('format', 'kind', 'number', 'id', 'record_sha256', 'previous', 'key', 'signature')


@dataclass(frozen=True)
class Seal:
    """
    An entry of the chain, or its head.

    :param kind: ``record``, ``deleted`` (of a record that was deleted by its age) or ``head``.
    :param number: of the entry, from 1; of a head, that of the last entry.
    :param record_id: of the record; of a head, empty.
    :param record_sha256: of the bytes of ``record.json``; of a head, of the last entry.
    :param previous: SHA-256 of the line of the entry before.
    :param key: public key that signed it, hex; empty where none did.
    :param signature: hex; empty likewise.
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
        """Return the one text that stands for it, without its line end."""
        return canonical({**self._content(), 'signature': self.signature})

    @property
    def sha256(self) -> str:
        """Return the SHA-256 of its line, that the next one is tied to."""
        return sha256(self.line)

    def signed(self, key: Optional[Ed25519PrivateKey]) -> Seal:
        """Return it signed; as it is where there is no key."""
        if key is None:
            return self
        bare = replace(self, key=public_hex(key.public_key()), signature='')
        return replace(bare, signature=key.sign(bare._signed_text()).hex())

    def fault(self, trusted: Sequence[str]) -> str:
        """
        Return what is wrong with its signature; nothing where it is right.

        :param trusted: public keys, hex, of which one must have signed; with none given any may,
            or none.
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
    """Return the seal that a line stands for; None where it is no seal to the byte."""
    try:
        data: Mapping[str, Any] = json.loads(line)
        if set(data) != set(_FIELDS) or data['format'] != FORMAT:
            return None
        seal = Seal(*(data[name] for name in _FIELDS[1:]))
        texts = (seal.kind, seal.record_id, seal.record_sha256, seal.previous, seal.key,
                 seal.signature)
        if not all(isinstance(text, str) for text in texts) or type(seal.number) is not int:
            return None
        # one text for one content: hex digits have no other writing
        if not all(_HEX.fullmatch(text) for text in texts[2:]):
            return None
        return seal if seal.line == line else None
    except (ValueError, TypeError, KeyError):
        return None


def tip(chain: Sequence[Seal]) -> str:
    """Return the SHA-256 that the next entry of a chain is tied to."""
    return chain[-1].sha256 if chain else NOTHING


def follows(seal: Seal, chain: Sequence[Seal]) -> bool:
    """Return whether a seal is the next entry of a chain."""
    return seal.number == len(chain) + 1 and seal.previous == tip(chain)


def head_of(chain: Sequence[Seal], key: Optional[Ed25519PrivateKey]) -> Seal:
    """Return the head of a chain, signed where there is a key."""
    return Seal(HEAD, len(chain), '', tip(chain), '').signed(key)


def entry_after(chain: Sequence[Seal], kind: str, record_id: str, record_sha256: str,
                key: Optional[Ed25519PrivateKey]) -> Seal:
    """Return the entry of a record, or of its deletion, that continues a chain."""
    return Seal(kind, len(chain) + 1, record_id, record_sha256, tip(chain)).signed(key)


def public_hex(key: Ed25519PublicKey) -> str:
    """Return a public key as hex."""
    return key.public_bytes(serialization.Encoding.Raw,
                            serialization.PublicFormat.Raw).hex()


def load_private_key(path: Union[str, Path]) -> Ed25519PrivateKey:
    """
    Read the key that signs: Ed25519, PEM (PKCS 8), without a password.

    :raises InputError: another file.
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
    Read the key that signatures are checked by: Ed25519, PEM.

    :return: hex.
    :raises InputError: another file.
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
    Write a new key that signs, PEM, which only its owner may read, and the public one beside it.

    :param path: a new file.
    :return: the file of the public key.
    :raises InputError: a file that is there already, or cannot be written.
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
    """Return the file of the public key beside a private one."""
    return key.with_name(key.name + '.pub')
