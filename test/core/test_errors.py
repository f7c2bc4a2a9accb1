# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Errors are one line, and survive the transfer from a worker process."""
from __future__ import annotations

import pickle

import pytest
from stereo_speed.core.errors import BagError, CalibrationError, InputError, SiteError


@pytest.mark.parametrize('kind', [InputError, SiteError, CalibrationError, BagError])
def test_errors_pickle_and_stay_one_line(kind):
    error = kind('a.yaml', 'lines', 'two\nlines', 'one')
    assert str(error) == 'a.yaml: lines: found two lines, wanted one'
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind and str(again) == str(error) and again.wanted == 'one'
