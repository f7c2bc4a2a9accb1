# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The journal keeps finished jobs through crashes, for one process at a time."""
from __future__ import annotations

import pytest
from stereo_speed.batch.journal import JOURNAL, Journal
from stereo_speed.core.errors import InputError


def test_last_row_of_each_key_is_read_back(tmp_path):
    with Journal(tmp_path / 'new') as journal:
        assert journal.rows() == {}
        for value in (1, 2):
            journal.append({'key': 'a', 'value': value})
        journal.append({'key': 'b', 'value': None})
    with Journal(tmp_path / 'new') as journal:
        assert journal.rows() == {'a': {'key': 'a', 'value': 2}, 'b': {'key': 'b', 'value': None}}


def test_truncated_row_is_ignored_and_the_next_is_on_its_own_line(tmp_path):
    with Journal(tmp_path) as journal:
        journal.append({'key': 'a'})
        journal.append({'key': 'b'})
    path = tmp_path / JOURNAL
    path.write_text(path.read_text()[:-4])
    with Journal(tmp_path) as journal:
        assert list(journal.rows()) == ['a']
        journal.append({'key': 'c'})
        assert list(journal.rows()) == ['a', 'c']


@pytest.mark.parametrize('line', ['[]', '3', '{}', 'word', '{"name": "a"}'])
def test_invalid_lines_are_ignored(line, tmp_path):
    (tmp_path / JOURNAL).write_text(line + '\n{"key": "a"}\n')
    with Journal(tmp_path) as journal:
        assert list(journal.rows()) == ['a']


def test_two_runs_cannot_share_a_folder(tmp_path):
    with Journal(tmp_path):
        with pytest.raises(InputError, match='another run'):
            Journal(tmp_path)
    with Journal(tmp_path):
        pass


def test_without_a_folder_nothing_is_kept():
    with Journal(None) as journal:
        journal.append({'key': 'a'})
        assert journal.rows() == {}
