# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Mappings of a file, read key by key."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.errors import SiteError
from stereo_speed.core.strict_yaml import load_yaml, StrictMapping

QUAD = [[10, 10], [50, 11], [51, 40], [9, 39]]


def mapping(**data):
    """Make a mapping whose keys are all allowed."""
    return StrictMapping('f.yaml', 'at', data, tuple(data))


def test_given_values_are_returned():
    fields = mapping(n=2, f=-0.5, all=[1, 2.5], name='a', names=['a', 'b'], quad=QUAD,
                     flat=[[1, 2]])
    two = fields.number('n', 0, 9, 'm')
    assert two == 2.0 and isinstance(two, float)
    assert fields.number('f', -0.5, 0, 'm') == -0.5  # bounds are allowed
    np.testing.assert_array_equal(fields.numbers('all', 0, 3, 'px'), [1.0, 2.5])
    assert fields.choice('name', ('a', 'b')) == 'a'
    assert fields.choices('names', {'a': 1, 'b': 2}) == ['a', 'b']
    np.testing.assert_array_equal(fields.quad('quad'), QUAD)
    np.testing.assert_array_equal(fields.points('flat', 2, 1, 1), [[1.0, 2.0]])
    assert fields.integer('n') == 2 and 'n' in fields and 'm' not in fields


@pytest.mark.parametrize('value', [
    True, 'x', None, float('nan'), float('inf'), -1, 10.1, [1]])
def test_number_out_of_bounds_is_refused(value):
    with pytest.raises(SiteError, match=r'f.yaml: at.n: found .* wanted degrees in \[0, 10\]'):
        mapping(n=value).number('n', 0, 10, 'degrees')


@pytest.mark.parametrize('read, value, match', [
    (lambda f: f.numbers('k', 0, 1, 'px'), [0.5, 2], r'at.k\[1\]: found 2, wanted px'),
    (lambda f: f.numbers('k', 0, 1, 'px'), [], 'at.k: found an empty list'),
    (lambda f: f.numbers('k', 0, 1, 'px'), 0.5, 'at.k: found 0.5, wanted a list'),
    (lambda f: f.choice('k', ('a', 'b')), 'c', "at.k: found 'c', wanted one of a, b"),
    (lambda f: f.choice('k', ('a', 'b')), 3, 'at.k: found 3, wanted a name'),
    (lambda f: f.choices('k', ('a', 'b')), ['a', ['b']], 'at.k: found a list, wanted one of'),
    (lambda f: f.points('k', 2, 1, 1), [[1, 2], [3, 4]], 'at.k: found 2 points, wanted 1'),
    (lambda f: f.points('k', 2, 2), [[1, 2]], 'at.k: found 1 points, wanted at least 2'),
    (lambda f: f.points('k', 2, 1), [[1, 2e9]], r'at.k\[0\]: found 2000000000.0'),
    (lambda f: f.quad('k'), QUAD[:3], 'at.k: found 3 points, wanted at least 4'),
    (lambda f: f.quad('k'), QUAD + QUAD[:1], 'at.k: found 5 points, wanted 4'),
    (lambda f: f.quad('k'), QUAD[::-1], 'wanted corners clockwise'),
    (lambda f: f.quad('k'), QUAD[1:] + QUAD[:1], "from the image's top-left corner"),
    (lambda f: f.integer('k'), -1, 'at.k: found -1, wanted an integer from 0'),
    (lambda f: f.text('k'), ' ', "at.k: found ' ', wanted a name"),
])
def test_faults_name_the_place(read, value, match):
    with pytest.raises(SiteError, match=match):
        read(mapping(k=value))


def test_unknown_keys_and_no_mapping():
    with pytest.raises(SiteError, match='at.b: found unknown key b, wanted one of a'):
        StrictMapping('f.yaml', 'at', {'a': 1, 'b': 2}, ('a',))
    with pytest.raises(SiteError, match='at: found a list, wanted a mapping with a'):
        StrictMapping('f.yaml', 'at', [], ('a',))


def test_unsupported_versions_are_refused(tmp_path):
    path = tmp_path / 'f.yaml'
    path.write_text('kind: 1\nvalue: 2\n')
    assert load_yaml(path, 'kind') == {'kind': 1, 'value': 2}
    with pytest.raises(SiteError, match='other: found nothing, wanted 1'):
        load_yaml(path, 'other')
