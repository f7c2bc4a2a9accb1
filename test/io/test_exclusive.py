# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Only one run at a time writes a file, and its content is kept."""
from __future__ import annotations

import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.io.exclusive import open_alone


def test_one_run_at_a_time_and_the_next_appends(tmp_path):
    path = tmp_path / 'runs.jsonl'
    with open_alone(path, 'journal') as first:
        first.write('one\n')
        with pytest.raises(InputError, match=r'runs\.jsonl: journal: found another run that is '
                                             'writing it, wanted a folder for each run'):
            open_alone(path, 'journal')
    with open_alone(path, 'journal') as second:
        second.write('two\n')
    assert path.read_text() == 'one\ntwo\n'
