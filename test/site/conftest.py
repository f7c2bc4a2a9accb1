# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Files of sites for the tests of their reading."""
from __future__ import annotations

import copy

import pytest
import yaml


@pytest.fixture
def write(tmp_path):
    """Return a writer of YAML files."""
    def writer(data):
        path = tmp_path / 'file.yaml'
        path.write_text(data if isinstance(data, str) else yaml.safe_dump(data))
        return path
    return writer


@pytest.fixture(scope='session')
def put():
    """Return a function that copies a structure with one place changed; None removes it."""
    def changed(base, place, value):
        data = copy.deepcopy(base)
        at = data
        for key in place[:-1]:
            at = at[key]
        if value is None:
            del at[place[-1]]
        else:
            at[place[-1]] = value
        return data
    return changed
