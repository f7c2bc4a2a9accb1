# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Boxes of the MOTChallenge: exact round trip, and bad files."""
import math
import re

import numpy as np
import pytest

from stereo_speed.core.errors import InputError
from stereo_speed.io.mot import boxes_text, load_truth


def test_boxes_are_written_exactly(estimate):
    turned = estimate(2, 7, (10, 20, 8, 4), math.pi / 2)
    assert boxes_text([turned, estimate(2, 1), estimate(1, 7)]) == (
        '1,7,1.000,2.000,3.000,4.000,0.875,-1,-1,-1\n'
        '2,1,1.000,2.000,3.000,4.000,0.875,-1,-1,-1\n'
        '2,7,12.000,18.000,4.000,8.000,0.875,-1,-1,-1\n')  # the upright box around it


def test_boxes_round_trip(written, estimate):
    rng = np.random.default_rng(0)
    estimates = [estimate(frame, number, rng.uniform(1, 700, 4), similarity=rng.uniform(0.1, 1))
                 for frame in range(1, 30, 3) for number in (2, 5)]
    found = load_truth(written(boxes_text(estimates), 'boxes.txt'))
    assert sorted(found) == [2, 5] and sorted(found[2]) == list(range(1, 30, 3))
    for e in estimates:
        np.testing.assert_allclose(found[e.id][e.frame], e.box_px, atol=6e-4)


def test_truth_of_the_motchallenge(written):
    path = written('3,1,912,484,97,109,0,7,1\n\n2,1,1,2,3,4,1,1,1\n2,-7,1.5,2,3,4\n'
                   '3,2,5,6,7,8,-1,-1,-1,-1\n', 'gt.txt')
    found = load_truth(path)
    assert {k: sorted(v) for k, v in found.items()} == {1: [2], -7: [2], 2: [3]}
    np.testing.assert_array_equal(found[-7][2], [1.5, 2, 3, 4])


@pytest.mark.parametrize('line', [
    '1,1,2,3,4', '0,1,2,3,4,5', '1.5,1,2,3,4,5', '1,1.5,2,3,4,5', '1,1,2,3,0,5', '1,1,2,3,4,-5',
    '1,1,nan,3,4,5', '1,1,2,inf,4,5', 'frame,id,x,y,w,h', '1;1;2;3;4;5', '1,1,2,3,,5'])
def test_invalid_truth_is_refused(written, line):
    path = written(f'1,1,2,3,4,5\n{line}\n', 'gt.txt')
    with pytest.raises(InputError, match=f'^{re.escape(str(path))}: line 2: found '
                                         f'{re.escape(repr(line))}, wanted frame,id,x,y,w,h'):
        load_truth(path)


def test_missing_truth_is_refused(tmp_path, written):
    with pytest.raises(InputError, match=r'gt\.txt: file: found .*No such file'):
        load_truth(tmp_path / 'gt.txt')
    (tmp_path / 'gt.txt').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(InputError, match=r'gt\.txt: file: found .*decode'):
        load_truth(tmp_path / 'gt.txt')
    for text in ('', '1,1,2,3,4,5,0\n'):
        with pytest.raises(InputError, match=r'gt\.txt: boxes: found none'):
            load_truth(written(text, 'gt.txt'))
