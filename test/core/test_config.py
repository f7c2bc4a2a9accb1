# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Config records: bounds, choices, sections, and the texts of errors."""
from __future__ import annotations

from dataclasses import dataclass

import pytest
from stereo_speed.core.config import (
    CheckedRecord, load_config, parameter, parameters_of, record_of, section)
from stereo_speed.core.errors import InputError


@dataclass(frozen=True)
class Inner(CheckedRecord):
    """A section."""

    share: float = parameter(0.5, 0.0, 1.0, '', 'a share')
    name: str = parameter('a', doc='a name', choices=('a', 'b'))


@dataclass(frozen=True)
class Outer(CheckedRecord):
    """A record with a section."""

    count: int = parameter(3, 1, 9, '', 'a number')
    exact: bool = parameter(False, doc='a switch')
    inner: Inner = section(Inner, 'inner ones')


def test_omitted_parameters_keep_their_defaults():
    assert record_of(Outer, {}, 'file') == Outer()
    found = record_of(Outer, {'count': 4, 'exact': True, 'inner': {'share': 1}}, 'file')
    assert found == Outer(count=4, exact=True, inner=Inner(share=1))


@pytest.mark.parametrize(('data', 'line'), [
    ({'count': 10}, 'file: count: found 10, wanted int in [1, 9]'),
    ({'count': 2.0}, 'file: count: found 2.0, wanted int in [1, 9]'),
    ({'count': True}, 'file: count: found True, wanted int in [1, 9]'),
    ({'exact': 1}, 'file: exact: found 1, wanted bool'),
    ({'inner': {'share': float('nan')}},
     'file: inner.share: found nan, wanted float in [0.0, 1.0]'),
    ({'inner': {'name': 'c'}}, "file: inner.name: found 'c', wanted one of a, b"),
    ({'inner': {'shore': 0.1}}, 'file: key: found inner.shore, wanted one of inner.share, '
     'inner.name'),
    ({'inner': 3}, 'file: inner: found int, wanted a mapping of parameters'),
    ({'outer': 3}, 'file: key: found outer, wanted one of count, exact, inner'),
    ([1], 'file: top level: found list, wanted a mapping of parameters'),
], ids=str)
def test_error_is_one_line_that_names_the_fault(data, line):
    with pytest.raises(InputError) as caught:
        record_of(Outer, data, 'file')
    assert str(caught.value) == line


def test_section_must_be_its_record():
    with pytest.raises(InputError, match='inner'):
        Outer(inner=0.5)


def test_bounds_hold_for_records_without_checks_of_their_own():
    @dataclass(frozen=True)
    class Careless:
        share: float = parameter(0.5, 0.0, 1.0, '', 'a share')
    with pytest.raises(InputError, match='file: share: found 2.0'):
        record_of(Careless, {'share': 2.0}, 'file')


def test_parameter_names_are_dotted():
    assert [name for name, _ in parameters_of(Outer, 'p.')] == [
        'p.count', 'p.exact', 'p.inner.share', 'p.inner.name']


@pytest.mark.parametrize('text', ['[1, 2]', 'count: [', 'count: 10'], ids=str)
def test_unusable_files_are_named(text, tmp_path):
    path = tmp_path / 'config.yaml'
    path.write_text(text)
    with pytest.raises(InputError, match='config.yaml'):
        load_config(path, Outer)
