# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How parameters are declared, once each, with default, unit, bounds and meaning.

A config record is a frozen dataclass of :func:`parameter` and :func:`section` fields.  The YAML
files of ``config/``, the command line and the ROS parameters all derive from such records.  Those
of the trackers are in ``tracker_config``, others beside the code that uses them.
"""
from __future__ import annotations

import dataclasses
from dataclasses import dataclass
import math
import operator
from pathlib import Path
from typing import Any, ClassVar, Iterator, Mapping, Optional, Protocol, TypeVar, Union

from .errors import InputError
from .strict_yaml import read_yaml
from .units import is_finite

Value = Union[bool, int, float, str]
_Value = TypeVar('_Value', bool, int, float, str)
_UNBOUNDED = 1e308  # bound of numbers for which none is given


class ConfigRecord(Protocol):
    """Any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]


Record = TypeVar('Record', bound=ConfigRecord)


def parameter(default: _Value, low: float = -_UNBOUNDED, high: float = _UNBOUNDED, unit: str = '',
              doc: str = '', *, choices: tuple[Value, ...] = (), below: str = '',
              at_least: str = '') -> _Value:
    """
    Return a field of a config record that carries its unit, bounds and meaning.

    :param default: value when the user sets none; its type is the type of the parameter.
    :param low: smallest legal value of a number.
    :param high: largest legal value of a number.
    :param unit: unit of a number.
    :param doc: meaning of the parameter.
    :param choices: the legal values, if only these are allowed.
    :param below: name of a parameter of the same record that must be greater than this one.
    :param at_least: name of a parameter of the same record that must not be greater than this one.
    """
    meta = {'low': low, 'high': high, 'unit': unit, 'doc': doc, 'choices': choices,
            'below': below, 'at_least': at_least}
    field: _Value = dataclasses.field(default=default, metadata=meta)
    return field


def section(kind: type[Record], doc: str) -> Record:
    """
    Return a field that nests a config record, with its defaults, in another one.

    :param kind: class of the nested record.
    :param doc: what its parameters have in common.
    """
    field: Record = dataclasses.field(default_factory=kind, metadata={'section': kind, 'doc': doc})
    return field


@dataclass(frozen=True)
class CheckedRecord:
    """A config record whose bounds are checked on construction."""

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True)
class NoParameters:
    """Settings of a tracker or detector without parameters."""


def check_bounds(config: ConfigRecord) -> None:
    """
    Check each parameter of a config record against its bounds or choices and related parameters.

    :raises InputError: a parameter that is illegal; names the field, the value and what is legal.
    """
    for f in dataclasses.fields(config):
        value = getattr(config, f.name)
        if 'section' in f.metadata:
            if not isinstance(value, f.metadata['section']):
                raise InputError('configuration', f.name, repr(value), 'a mapping of parameters')
        elif not _is_legal(f, value):
            raise InputError('configuration', f.name, repr(value), wanted_of(f))
    for f in dataclasses.fields(config):
        for key, words, holds in (('below', 'less than', operator.lt),
                                  ('at_least', 'at least', operator.ge)):
            other = f.metadata.get(key)
            if other and not holds(getattr(config, f.name), getattr(config, other)):
                raise InputError('configuration', f.name, getattr(config, f.name),
                                 f'{words} {other}, {getattr(config, other)}')


def wanted_of(field: dataclasses.Field[Any]) -> str:
    """Return a text that describes the legal values of a parameter."""
    meta, kind = field.metadata, type(field.default).__name__
    if meta['choices']:
        return 'one of ' + ', '.join(str(choice) for choice in meta['choices'])
    if isinstance(field.default, (bool, str)):
        return kind
    return f'{kind} in [{meta["low"]}, {meta["high"]}] {meta["unit"]}'.strip()


def _is_legal(field: dataclasses.Field[Any], value: object) -> bool:
    """Return whether a value has the type of a parameter and is within its bounds."""
    meta, kind = field.metadata, type(field.default)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        # An integer that is too large for a float is out of any bounds.
        value = float(value) if is_finite(value) else math.inf
    if type(value) is not kind:
        return False
    if meta['choices']:
        return value in meta['choices']
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return is_finite(value) and bool(meta['low'] <= value <= meta['high'])
    return True


def parameters_of(kind: type[ConfigRecord], prefix: str = ''
                  ) -> Iterator[tuple[str, dataclasses.Field[Any]]]:
    """
    Yield the dotted name and the field of every parameter of a record and of its sections.

    :param kind: class of the record.
    :param prefix: prepended to each name.
    """
    for f in dataclasses.fields(kind):
        if 'section' in f.metadata:
            yield from parameters_of(f.metadata['section'], f'{prefix}{f.name}.')
        else:
            yield prefix + f.name, f


def read_yaml_mapping(path: Union[str, Path]) -> Mapping[str, object]:
    """
    Read a YAML mapping of parameters.

    :raises InputError: an unreadable file, or one whose top level is not a mapping.
    """
    data = read_yaml(path, InputError)
    if not isinstance(data, Mapping):
        raise InputError(path, 'top level', type(data).__name__, 'a mapping of parameters')
    return data


def record_of(kind: type[Record], data: object, where: object, prefix: str = '') -> Record:
    """
    Return a config record made from a mapping, with defaults for what it leaves out.

    :param kind: class of the record.
    :param data: parameter names to values, section names to mappings; not with dotted names.
    :param where: file, for errors.
    :param prefix: dotted name of the section, for errors.
    :raises InputError: an unknown key, or a value out of bounds.
    """
    if not isinstance(data, Mapping):
        raise InputError(where, prefix.rstrip('.') or 'top level', type(data).__name__,
                         'a mapping of parameters')
    fields = {f.name: f for f in dataclasses.fields(kind)}
    values = {}
    for key, value in data.items():
        if key not in fields:
            raise InputError(where, 'key', f'{prefix}{key}',
                             'one of ' + ', '.join(prefix + name for name in fields))
        inner = fields[key].metadata.get('section')
        values[key] = value if inner is None else record_of(inner, value, where, f'{prefix}{key}.')
    try:
        record = kind(**values)
        check_bounds(record)  # records of other packages may not check themselves
    except InputError as error:
        raise InputError(where, prefix + error.what, error.found, error.wanted) from None
    return record


def load_config(path: Optional[Union[str, Path]], kind: type[Record]) -> Record:
    """
    Return the config record that a YAML file describes; parameters not in it keep their defaults.

    :param path: path of the file; None gives the defaults.
    :param kind: class of the config record.
    :raises InputError: unreadable file, unknown key or value out of bounds.
    """
    return kind() if path is None else record_of(kind, read_yaml_mapping(path), path)
