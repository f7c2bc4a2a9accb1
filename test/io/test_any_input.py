# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Any YAML file and any image bytes give a result or one clear line."""
from __future__ import annotations

from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
import pytest
from stereo_speed.core.config import load_config
from stereo_speed.core.errors import InputError
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.io.decoding import decode_image, stated_size
from stereo_speed.io.scene_map import load_regions
from stereo_speed.io.targets_file import load_targets
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
import yaml

SCALARS = (st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
           | st.dates())
TREES = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(
    SCALARS, inner, max_size=4), max_leaves=12)
NUMBERS = st.integers() | st.floats()
POINTS = st.lists(st.lists(NUMBERS, min_size=2, max_size=2), max_size=5)
LINES = st.dictionaries(st.text(max_size=4), st.fixed_dictionaries(
    {'left_image': POINTS, 'right_image': POINTS}) | st.fixed_dictionaries(
    {'points_m': st.lists(st.lists(NUMBERS, min_size=3, max_size=3), max_size=4)}), max_size=3)
quick = settings(max_examples=40, deadline=None, derandomize=True, database=None,
                 suppress_health_check=[HealthCheck.function_scoped_fixture])


def loads(load, path, tree):
    """Write a tree, read it, and check that a refusal is one line."""
    path.write_text(yaml.safe_dump(tree, allow_unicode=True), encoding='utf-8')
    try:
        load(path)
    except InputError as error:
        assert str(error).startswith(str(path))
        assert '\n' not in str(error)


@pytest.mark.parametrize(('load', 'head'), [
    (load_site, 'stereo_speed_site'), (load_init, 'stereo_speed_init'),
    (load_regions, 'stereo_speed_map'), (load_targets, 'environment_targets')],
    ids=['site', 'init', 'map', 'targets'])
@quick
@given(tree=TREES)
def test_any_tree(tmp_path, load, head, tree):
    keys = {'stereo_speed_site': 'lines', 'stereo_speed_init': 'vehicles',
            'stereo_speed_map': 'regions', 'environment_targets': 'targets'}
    loads(load, tmp_path / 'file.yaml', {head: 1, keys[head]: tree})
    loads(load, tmp_path / 'file.yaml', tree)


@quick
@given(lines=LINES, lanes=st.lists(TREES, max_size=2))
def test_any_lines_and_lanes(tmp_path, lines, lanes):
    loads(load_site, tmp_path / 'site.yaml',
          {'stereo_speed_site': 1, 'lines': lines, 'lanes': lanes})


@quick
@given(tree=st.dictionaries(st.sampled_from(['particles', 'verdict', 'noise', 'effort']), TREES))
def test_any_parameters(tmp_path, tree):
    path = tmp_path / 'config.yaml'
    path.write_text(yaml.safe_dump(tree))
    try:
        load_config(path, TrackerConfig)
    except InputError as error:
        assert '\n' not in str(error)


@quick
@given(data=st.binary(max_size=200), head=st.sampled_from(
    [b'', b'\xff\xd8\xff', b'\xff\xd8\xff\xc0', b'\x89PNG\r\n\x1a\n', b'BM', b'II*\x00']))
def test_any_bytes_of_an_image(capfd, data, head):
    stated_size(head + data)
    image, why = decode_image(np.frombuffer(head + data, np.uint8), 0)
    assert (image is None) == bool(why)
    assert capfd.readouterr().err == ''
