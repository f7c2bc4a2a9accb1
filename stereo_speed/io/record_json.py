# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Convert records to lines of JSON and back without loss of floats and arrays."""
from __future__ import annotations

import dataclasses
from enum import Enum
import json
from typing import Any

import numpy as np

from ..core import passes, records
from ..core.errors import InputError

_TYPE, _VALUE = '!', 'v'
_KINDS = {**vars(records), **vars(passes)}  # the only types that are read back


def record_text(value: Any) -> str:
    """
    Return a value as one line of JSON.

    :param value: made of records and enumerations of ``core.records`` and ``core.passes``, and of
        numbers, texts, arrays, lists, tuples (read back as lists) and dictionaries.
    """
    return json.dumps(_plain(value), separators=(',', ':'))


def record_of(text: str, where: object) -> Any:
    """
    Return the value of a line.

    :param text: a line of :func:`record_text`.
    :param where: file, for errors.
    :raises InputError: the text describes no such value.
    """
    try:
        return _value(json.loads(text))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(where, 'line', f'{type(error).__name__}: {error}',
                         'records of a run') from None


def _plain(value: Any) -> Any:
    """Return a value in JSON types; other types are stored with their name."""
    if isinstance(value, Enum):
        return {_TYPE: type(value).__name__, _VALUE: value.value}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {_TYPE: type(value).__name__, _VALUE: {
            f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}}
    if isinstance(value, np.ndarray):
        return {_TYPE: 'array', 'dtype': value.dtype.str, _VALUE: value.tolist()}
    if isinstance(value, dict):
        return {_TYPE: 'dict', _VALUE: [[_plain(k), _plain(v)] for k, v in value.items()]}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def _value(plain: Any) -> Any:
    """Invert :func:`_plain`, for known types only."""
    if isinstance(plain, list):
        return [_value(item) for item in plain]
    if not isinstance(plain, dict):
        return plain
    name, content = plain[_TYPE], plain[_VALUE]
    if name == 'array':
        return np.array(content, dtype=np.dtype(plain['dtype']))
    if name == 'dict':
        return {_value(k): _value(v) for k, v in content}
    kind = _KINDS[name]
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(content)
    if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
        raise TypeError(f'{name} is no record')
    return kind(**{key: _value(item) for key, item in content.items()})
