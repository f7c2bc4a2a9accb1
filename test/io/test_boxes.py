# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Files of boxes: accepted ones, and the errors of others."""
from __future__ import annotations

import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.detection.protocol import ImageBox
from stereo_speed.io.boxes import load_boxes

HEAD = 'stamp_ns,left_px,top_px,width_px,height_px'
FIRST = '1700000000123456789,10,20.5,30,40'


@pytest.fixture
def written(tmp_path):
    def write(*lines, newline='\n'):
        path = tmp_path / 'boxes.csv'
        path.write_bytes((newline.join(lines) + newline).encode())
        return path
    return write


def test_boxes_are_read_by_stamp_in_their_order(written):
    path = written(f'{HEAD},score', f'{FIRST},0.25', '5,1,2,3,4,1',
                   '1700000000123456789,-3,0,1,1,0')
    assert load_boxes(path) == {
        1700000000123456789: [
            ImageBox(left_px=10, top_px=20.5, width_px=30, height_px=40, score=0.25),
            ImageBox(left_px=-3, top_px=0, width_px=1, height_px=1, score=0)],
        5: [ImageBox(left_px=1, top_px=2, width_px=3, height_px=4, score=1)]}


def test_boxes_without_scores_have_the_score_one(written):
    (box,), = load_boxes(written(HEAD, FIRST)).values()
    assert box.score == 1.0


def test_columns_in_any_order_and_windows_line_ends_are_read(written):
    path = written('score,height_px,width_px,top_px,left_px,stamp_ns', '0.5,4,3,2,1,7',
                   newline='\r\n')
    assert load_boxes(path) == {
        7: [ImageBox(left_px=1, top_px=2, width_px=3, height_px=4, score=0.5)]}


def test_byte_order_mark_is_ignored(tmp_path):
    path = tmp_path / 'boxes.csv'
    path.write_text(f'{HEAD}\n{FIRST}\n', encoding='utf-8-sig')
    assert len(load_boxes(path)) == 1


def test_file_without_rows_has_no_vehicles(written):
    assert load_boxes(written(HEAD)) == {}


@pytest.mark.parametrize(('lines', 'said'), [
    (('stamp_ns,left_px',), 'columns: found stamp_ns,left_px, wanted stamp_ns,left_px,top_px'),
    ((f'{HEAD},label',), 'columns: .*label, wanted'),
    ((f'{HEAD},left_px',), 'columns'),
    (('',), 'columns: found none'),
    ((HEAD, '1,2,3,4'), 'line 2: found a different number of values'),
    ((HEAD, FIRST, '1,2,3,4,5,6'), 'line 3: found a different number of values'),
    ((HEAD, '1.5,2,3,4,5'), "line 2, stamp_ns: found '1.5', wanted an integer of nanoseconds"),
    ((HEAD, '-1,2,3,4,5'), 'line 2, stamp_ns'),
    ((HEAD, '9223372036854775808,2,3,4,5'), 'line 2, stamp_ns'),
    ((HEAD, '1,x,3,4,5'), "line 2, left_px: found 'x', wanted a column in px"),
    ((HEAD, '1,2,nan,4,5'), 'line 2, top_px'),
    ((HEAD, FIRST, '1,2,3,0,5'), "line 3, width_px: found '0', wanted a width above 0 px"),
    ((HEAD, '1,2,3,4,-5'), 'line 2, height_px'),
    ((HEAD, '1,2,3,4,inf'), 'line 2, height_px'),
    ((f'{HEAD},score', '1,2,3,4,5,1.5'), "line 2, score: found '1.5', wanted a confidence"),
    ((HEAD, '1,2,3,4,"5'), 'line 2: found'),
], ids=lambda value: str(value)[:40])
def test_fault_is_named_by_file_line_and_column(written, lines, said):
    path = written(*lines)
    with pytest.raises(InputError, match=said) as caught:
        load_boxes(path)
    assert str(caught.value).startswith(str(path)) and '\n' not in str(caught.value)


def test_unreadable_file_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match='boxes.csv: file'):
        load_boxes(tmp_path / 'boxes.csv')
    (tmp_path / 'boxes.csv').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(InputError, match='wanted a readable CSV file of boxes'):
        load_boxes(tmp_path / 'boxes.csv')
