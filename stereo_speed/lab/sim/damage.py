# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Damage files: bytes, values of a YAML file, or records of an MCAP file."""
from __future__ import annotations

import binascii
import struct
from typing import Any, Callable, Optional

import numpy as np

Wound = Callable[[np.random.Generator, bytes], bytes]
MAGIC = b'\x89MCAP0\r\n'
CHUNK, MESSAGE = 0x06, 0x05
# Unexpected values: ends of ranges, other types, and texts that parse as another type.
STRANGE: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 3, 2 ** 31, 2 ** 63, 2 ** 64, -2 ** 63, 10 ** 400, 0.5, -0.0,
    1e-320, 1e9, 1e300, float('nan'), float('inf'), float('-inf'), '', ' ', 'nan', '1e3', '0x10',
    '55 mph', 'mph', '-5 km/h', '\x00', '\u202e', 'é' * 3, 'x' * 5000, '../../etc/passwd', '<b>',
    'lane\nlane', [], [[]], [[], []], [0], [0, 0], [None], ['a', 'b'], [1, 2, 3], {}, {'a': 1},
    {1: 2}, [[0, 0]] * 4, [[float('nan'), 0]] * 4, [[1e9, 1e9]] * 20)


def damage_bytes(rng: np.random.Generator, data: bytes, most: int = 4) -> bytes:
    """
    Damage bytes as transport, disks or an attacker would.

    :param rng: source of randomness.
    :param data: the bytes.
    :param most: greatest number of changes.
    """
    for _ in range(int(rng.integers(1, most + 1))):
        data = _WOUNDS[int(rng.integers(len(_WOUNDS)))](rng, data)
    return data


def damage_value(rng: np.random.Generator, value: Any) -> Any:
    """
    Return a tree of mappings, lists and values with one of its nodes changed.

    :param rng: source of randomness.
    :param value: a value from ``yaml.safe_load``; it is not changed.
    """
    inner = list(value.items()) if isinstance(value, dict) else list(
        enumerate(value)) if isinstance(value, list) else []
    if not inner or rng.random() < 0.12:
        return _strange(rng)
    key, child = inner[int(rng.integers(len(inner)))]
    kind, rest = rng.random(), [item for item in inner if item[0] != key]
    if kind < 0.12:
        changed = rest
    elif kind < 0.2:
        changed = [*inner, (key if isinstance(value, list) else _name(rng), _strange(rng))]
    else:
        changed = [(k, damage_value(rng, v) if k == key else v) for k, v in inner]
    return dict(changed) if isinstance(value, dict) else [v for _, v in changed]


def _strange(rng: np.random.Generator) -> Any:
    return STRANGE[int(rng.integers(len(STRANGE)))]


def _name(rng: np.random.Generator) -> Any:
    """Return a key; values that cannot be keys are converted to text."""
    value = _strange(rng)
    return str(value) if isinstance(value, (list, dict)) else value


def damage_mcap(rng: np.random.Generator, data: bytes) -> bytes:
    """
    Damage the structure of an MCAP file.

    Lengths and opcodes of records are falsified, and records are removed, duplicated or swapped;
    or a message in a chunk is damaged and the chunk's checksum corrected.

    :param rng: source of randomness.
    :param data: a complete file with uncompressed chunks.
    """
    records = split_records(data)
    if not records:
        return damage_bytes(rng, data)
    at = int(rng.integers(len(records)))
    opcode, body = records[at]
    kind = int(rng.integers(7))
    lie: Optional[int] = None
    if kind == 0:
        del records[at]
    elif kind == 1:
        records.insert(at, records[int(rng.integers(len(records)))])
    elif kind == 2:
        lie = int(rng.choice([0, 1, len(body) - 1, len(body) + 1, 2 ** 31, 2 ** 40, 2 ** 63])) % (
            2 ** 64)
    elif kind == 3:
        records[at] = (int(rng.integers(256)), body)
    elif kind == 4:
        records[at] = (opcode, damage_bytes(rng, body))
    elif kind == 5:
        records[at] = (opcode, _with_number(rng, body))
    else:
        chunks = [k for k, (code, _) in enumerate(records) if code == CHUNK]
        at = chunks[int(rng.integers(len(chunks)))] if chunks else at
        records[at] = (records[at][0], damage_chunk(rng, records[at][1]))
    out = [MAGIC]
    for k, (code, content) in enumerate(records):
        length = lie if lie is not None and k == at else len(content)
        out.append(struct.pack('<BQ', code, length) + content)
    return b''.join([*out, MAGIC])


def split_records(data: bytes) -> list[tuple[int, bytes]]:
    """Return opcode and content of each record of an MCAP file; empty where it is invalid."""
    records, at = [], len(MAGIC)
    while at + 9 <= len(data) - len(MAGIC):
        opcode, length = struct.unpack_from('<BQ', data, at)
        if at + 9 + length > len(data):
            return []
        records.append((opcode, data[at + 9:at + 9 + length]))
        at += 9 + length
    return records


def damage_chunk(rng: np.random.Generator, body: bytes) -> bytes:
    """
    Damage a message in an uncompressed chunk, and correct the checksum.

    :param rng: source of randomness.
    :param body: content of the chunk's record.
    """
    if len(body) < 40:
        return damage_bytes(rng, body)
    named = struct.unpack_from('<I', body, 28)[0]
    start = 32 + named + 8
    content = bytearray(body[start:])
    places, at = [], 0
    while at + 9 <= len(content):
        opcode, length = struct.unpack_from('<BQ', content, at)
        if opcode == MESSAGE:
            places.append((at, int(length)))
        at += 9 + int(length)
    if places:
        at, length = places[int(rng.integers(len(places)))]
        # Mostly early in the message, where lengths and sizes are.
        reach = min(length, 120 if rng.random() < 0.7 else length)
        for _ in range(int(rng.integers(1, 5))):
            place = at + 9 + 22 + int(rng.integers(max(reach - 22, 1)))
            if place + 4 <= len(content):
                content[place:place + 4] = _number(rng)
        if rng.random() < 0.3:
            struct.pack_into('<Q', content, at + 1, int(rng.integers(2 ** 40)))
    head = bytearray(body[:start])
    struct.pack_into('<I', head, 24, binascii.crc32(content))
    return bytes(head + content)


def _number(rng: np.random.Generator) -> bytes:
    """Return four bytes of an unusual number."""
    value = int(rng.choice([0, 1, 255, 256, 65535, 2 ** 31 - 1, 2 ** 31, 2 ** 32 - 1, 4097]))
    return struct.pack('<I', value) if rng.random() < 0.7 else rng.bytes(4)


def _with_number(rng: np.random.Generator, body: bytes) -> bytes:
    if len(body) < 4:
        return body
    at = int(rng.integers(len(body) - 3))
    return body[:at] + _number(rng) + body[at + 4:]


def _flip(rng: np.random.Generator, data: bytes) -> bytes:
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 9)) if out else 0):
        out[int(rng.integers(len(out)))] ^= 1 << int(rng.integers(8))
    return bytes(out)


def _spliced(most: int, instead: Wound) -> Wound:
    """Return a function that replaces a section of up to ``most`` bytes."""
    def wound(rng: np.random.Generator, data: bytes) -> bytes:
        start = int(rng.integers(max(len(data), 1)))
        end = min(len(data), start + int(rng.integers(1, most + 1)))
        return data[:start] + instead(rng, data[start:end]) + data[end:]
    return wound


def _truncate(rng: np.random.Generator, data: bytes) -> bytes:
    return data[:int(rng.integers(len(data) + 1))]


_WOUNDS: tuple[Wound, ...] = (
    _flip,
    _spliced(64, lambda rng, part: rng.bytes(len(part))),  # replaced
    _spliced(4096, lambda rng, part: bytes(len(part))),  # zero
    _spliced(64, lambda rng, part: b''),  # deleted
    _spliced(512, lambda rng, part: part + part),  # doubled
    _spliced(64, lambda rng, part: rng.bytes(len(part)) + part),  # inserted
    _truncate, _with_number)
