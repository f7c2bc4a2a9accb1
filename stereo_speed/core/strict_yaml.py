# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Strict reading of small YAML files: known keys, finite numbers, errors that say where."""
from __future__ import annotations

from pathlib import Path
from typing import Any, Collection, Mapping, Optional, Sequence, Union

import numpy as np
import yaml

from .errors import InputError, SiteError
from .records import Array
from .units import is_finite, parse_speed


LARGEST = 1e9  # larger than any coordinate of a site in px or m; a larger number is a mistake


class _StrictLoader(yaml.SafeLoader):
    """YAML loader that refuses duplicate keys and integers too large for a float."""

    def construct_yaml_int(self, node: Any) -> int:
        """Build an integer, if a float can hold it."""
        value: int = super().construct_yaml_int(node)
        if not is_finite(value):
            raise yaml.constructor.ConstructorError(
                None, None, f'whole number of {value.bit_length()} bits', node.start_mark)
        return value

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Build a mapping without duplicate keys, of which the base class keeps the last."""
        seen = set()
        for key_node, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, (list, dict)):
                break  # the base class refuses it
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f'key {key!r} given twice', key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


_StrictLoader.add_constructor('tag:yaml.org,2002:int', _StrictLoader.construct_yaml_int)


def read_yaml(path: Union[str, Path], kind_of_error: type[InputError] = SiteError,
              text: Optional[str] = None) -> Any:
    """
    Return the content of a YAML file, of any type.

    :param path: path of the file.
    :param kind_of_error: error to raise if the file cannot be read.
    :param text: text of the file; None to read it.
    """
    if text is None:
        text = read_text(path, kind_of_error)
    try:
        return yaml.load(text, _StrictLoader)  # noqa: S506 (a safe loader, made stricter)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise _unreadable(path, error, kind_of_error) from None


def read_text(path: Union[str, Path], kind_of_error: type[InputError] = SiteError) -> str:
    """
    Return the text of a YAML file.

    :param kind_of_error: error to raise if it cannot be read.
    """
    try:
        return Path(path).read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as error:
        raise _unreadable(path, error, kind_of_error) from None


def _unreadable(path: Union[str, Path], error: Exception, kind_of_error: type[InputError]
                ) -> InputError:
    return kind_of_error(path, 'file', ' '.join(str(error).split()), 'readable YAML')


def load_yaml(path: Union[str, Path], version_key: str, text: Optional[str] = None
              ) -> Mapping[str, Any]:
    """
    Read a YAML mapping that states its kind and version as ``version_key: 1``.

    :param text: text of the file; None to read it.
    :raises SiteError: an unreadable file, no mapping, or another kind or version.
    """
    data = read_yaml(path, text=text)
    if not isinstance(data, Mapping):
        raise SiteError(path, 'top level', kind(data), f'a mapping with {version_key}: 1')
    version = data.get(version_key)
    if version != 1 or isinstance(version, bool):
        found = 'nothing' if version is None else repr(version)
        raise SiteError(path, version_key, found, '1')
    return data


def kind(value: Any) -> str:
    """Return a description of a YAML value for error messages."""
    names = {dict: 'a mapping', list: 'a list', str: f'{value!r}', type(None): 'nothing'}
    return names.get(type(value), repr(value))


def _within(value: Any, low: float, high: float) -> bool:
    """Return whether a YAML value is a finite number within bounds."""
    return not isinstance(value, bool) and isinstance(value, (int, float)) \
        and is_finite(value) and low <= value <= high


class StrictMapping:
    """
    One mapping of a file, whose values are read by typed methods.

    Each method raises a :class:`SiteError` that names the key if the value is missing or illegal.

    :param where: path of the file.
    :param what: place of the mapping in the file, such as ``lanes[0]``; empty at the top level.
    :param data: the mapping.
    :param known: keys that it may have.
    :raises SiteError: it is not a mapping, or has other keys.
    """

    def __init__(self, where: object, what: str, data: Any, known: Sequence[str]) -> None:
        self.where, self.what = where, what
        if not isinstance(data, Mapping):
            raise SiteError(where, what, kind(data), 'a mapping with ' + ', '.join(known))
        self.data = data
        for key in data:
            if key not in known:
                raise SiteError(where, self.name(str(key)), f'unknown key {key}',
                                'one of ' + ', '.join(known))

    def name(self, key: str) -> str:
        """Return the name of a key with its place in the file."""
        return f'{self.what}.{key}' if self.what else key

    def __contains__(self, key: str) -> bool:
        """Return whether the key is given."""
        return key in self.data

    def error(self, key: str, found: object, wanted: str) -> SiteError:
        """Return the error for a key."""
        return SiteError(self.where, self.name(key), found, wanted)

    def text(self, key: str) -> str:
        """Return a non-empty text."""
        value = self.data.get(key)
        if not isinstance(value, str) or not value.strip():
            raise self.error(key, kind(value), 'a name')
        return value

    def integer(self, key: str) -> int:
        """Return a non-negative integer."""
        value = self.data.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise self.error(key, kind(value), 'an integer from 0')
        return value

    def number(self, key: str, low: float, high: float, unit: str) -> float:
        """
        Return a finite number within bounds.

        :param low: smallest legal value.
        :param high: largest legal value.
        :param unit: unit of the value, for the error message.
        """
        return self._bounded(key, self.data.get(key), low, high, unit)

    def numbers(self, key: str, low: float, high: float, unit: str) -> Array:
        """Return a list of at least one number (n,), each as :meth:`number` accepts it."""
        return np.array([self._bounded(f'{key}[{i}]', value, low, high, unit)
                         for i, value in enumerate(self.listed(key))])

    def _bounded(self, key: str, value: Any, low: float, high: float, unit: str) -> float:
        """Return one number after checking its bounds."""
        if not _within(value, low, high):
            raise self.error(key, kind(value), f'{unit} in [{low:g}, {high:g}]')
        return float(value)

    def speed(self, key: str) -> float:
        """Return a speed, m/s, that the file gives with its unit."""
        try:
            return parse_speed(self.text(key))
        except ValueError:
            raise self.error(key, repr(self.data[key]),
                             "a speed like '55 mph', '80 km/h' or '22.2 m/s'") from None

    def choice(self, key: str, choices: Collection[str]) -> str:
        """Return a text that is one of the choices."""
        return self._chosen(key, self.text(key), choices)

    def choices(self, key: str, choices: Collection[str]) -> list[str]:
        """Return a list of texts, each of them one of the choices."""
        return [self._chosen(key, value, choices) for value in self.listed(key)]

    def _chosen(self, key: str, value: Any, choices: Collection[str]) -> str:
        """Return one text after checking that it is one of the choices."""
        if not isinstance(value, str) or value not in choices:
            raise self.error(key, kind(value), 'one of ' + ', '.join(choices))
        return value

    def quad(self, key: str) -> Array:
        """Return the corners (4, 2) of a convex quad, clockwise from its top-left corner."""
        quad = self.points(key, 2, 4, 4)
        side = np.roll(quad, -1, axis=0) - quad
        after = np.roll(side, -1, axis=0)
        clockwise = side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0] > 0
        if not (clockwise.all() and side[0, 0] > 0 and side[3, 1] < 0):
            raise self.error(key, quad.tolist(),
                             "corners clockwise from the image's top-left corner")
        return quad

    def listed(self, key: str) -> list[Any]:
        """Return a non-empty list."""
        value = self.data.get(key)
        if not isinstance(value, list) or not value:
            raise self.error(key, 'an empty list' if value == [] else kind(value), 'a list')
        return value

    def points(self, key: str, width: int, least: int, most: Optional[int] = None) -> Array:
        """
        Return (n, width) points, all finite.

        :param width: number of coordinates of each point.
        :param least: smallest legal number of points.
        :param most: largest legal number of points; None for no limit.
        """
        rows = self.listed(key)
        wanted = f'{width} finite numbers'
        for i, row in enumerate(rows):
            if not isinstance(row, list) or len(row) != width:
                found = f'{len(row)} values' if isinstance(row, list) else kind(row)
                raise self.error(f'{key}[{i}]', found, wanted)
            for value in row:
                if not _within(value, -LARGEST, LARGEST):
                    raise self.error(f'{key}[{i}]', kind(value), wanted)
        if len(rows) < least:
            raise self.error(key, f'{len(rows)} points', f'at least {least}')
        if most is not None and len(rows) > most:
            raise self.error(key, f'{len(rows)} points', f'{most}')
        return np.array(rows, dtype=np.float64)
