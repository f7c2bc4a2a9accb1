# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""No partial file ever appears, and errors are reported."""
import os

import pytest

from stereo_speed.core.errors import InputError
from stereo_speed.io.atomic import csv_text, staged, write_whole


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_text_and_bytes_are_written_exactly_into_a_new_folder(tmp_path):
    write_whole(tmp_path / 'a' / 'b', {'text': 'ä\r\n', 'bytes': b'\x00\n'})
    assert names(tmp_path / 'a' / 'b') == ['bytes', 'text']
    assert (tmp_path / 'a' / 'b' / 'text').read_bytes() == b'\xc3\xa4\r\n'
    assert (tmp_path / 'a' / 'b' / 'bytes').read_bytes() == b'\x00\n'


def test_failed_write_leaves_everything_unchanged(tmp_path):
    (tmp_path / 'mark').write_text('old')
    with pytest.raises(ZeroDivisionError):
        with staged(tmp_path, ('mark',)) as aside:
            (aside / 'mark').write_text('new')
            assert aside.parent == tmp_path and aside.name.startswith('.')
            1 / 0
    assert names(tmp_path) == ['mark'] and (tmp_path / 'mark').read_text() == 'old'


def test_completion_mark_is_removed_first_and_written_last(tmp_path, monkeypatch):
    for name in ('mark', 'table', 'picture', 'mine'):
        (tmp_path / name).write_text('old')
    seen, move = [], os.replace

    def watched(source, target):
        seen.append(names(tmp_path))
        move(source, target)
    monkeypatch.setattr(os, 'replace', watched)
    write_whole(tmp_path, {'mark': '1', 'table': '2', 'zeta': '3'}, ('mark', 'table', 'picture'))
    held = [[n for n in found if not n.startswith('.')] for found in seen]
    assert held == [['mine'], ['mine', 'table'], ['mine', 'table', 'zeta']]
    assert names(tmp_path) == ['mark', 'mine', 'table', 'zeta']
    assert (tmp_path / 'mine').read_text() == 'old'


def test_unwritable_path_is_named(tmp_path):
    (tmp_path / 'taken').mkdir()
    with pytest.raises(InputError, match='taken: output: found Is a directory, wanted a place'):
        write_whole(tmp_path, {'taken': 'text'})
    assert names(tmp_path) == ['taken']
    (tmp_path / 'file').write_text('')
    with pytest.raises(InputError, match='file: output folder: found'):
        write_whole(tmp_path / 'file', {'a': ''})


def test_csv_is_written_exactly():
    assert csv_text(('a', 'b c'), [(1, 'x, y'), (None, '"')]) == 'a,b c\n1,"x, y"\n,""""\n'
