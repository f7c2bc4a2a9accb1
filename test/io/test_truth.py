# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""True speeds by stamp, to the nanosecond."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.io.truth import read_truth, truth_of_rows

FULL = 'stamp,vehicle,speed,x,y,z\n' \
       '1700000000.200000,1,21.5,1,2,3\n1700000000.000000,1,21,1,2,4\n' \
       '1700000000.000000,0,9,5,6,7\n'


def written(tmp_path, text):
    path = tmp_path / 'truth.csv'
    path.write_text(text)
    return path


def test_vehicles_and_stamps_are_in_order(tmp_path):
    a, b = read_truth(written(tmp_path, FULL))
    assert (a.vehicle, b.vehicle) == (0, 1)
    assert b.stamps_ns.tolist() == [1_700_000_000_000_000_000, 1_700_000_000_200_000_000]
    assert b.speed_mps.tolist() == [21, 21.5]
    assert b.position_m.tolist() == [[1, 2, 4], [1, 2, 3]]


def test_stamps_match_to_the_microsecond(tmp_path):
    truth = read_truth(written(tmp_path, FULL))[1]
    base = 1_700_000_000_000_000_000
    stamps = [base, base + 999, base + 200_000_321, base + 100_000_000, base + 200_010_000, 0]
    assert truth.at(stamps).tolist() == [0, 0, 1, -1, -1, -1]
    speeds = truth.speed_at(stamps)
    assert speeds[:3].tolist() == [21, 21, 21.5]
    assert np.isnan(speeds[3:]).all()


def test_speed_column_is_sufficient(tmp_path):
    one, = read_truth(written(tmp_path, 'stamp,speed\n1.5,20\n'))
    assert one.vehicle == 0
    assert np.isnan(one.position_m).all()
    assert one.speed_at([1_500_000_000, 1_600_000_000])[0] == 20


def test_rows_of_a_simulation_need_no_file():
    one, = truth_of_rows([{'stamp_ns': 5, 'vehicle': 3, 'speed': 2.0, 'x': 1, 'y': 2, 'z': 3}])
    assert one.vehicle == 3
    assert one.at([5]).tolist() == [0]


@pytest.mark.parametrize(('text', 'wanted'), [
    ('time,speed\n1,2\n', 'columns'),
    ('stamp,speed\n', 'rows'),
    ('stamp,speed\n1,fast\n', 'line 2, speed'),
    ('stamp,speed\nnan,3\n', 'line 2, stamp'),
    ('stamp,speed,x,y,z\n1,3,a,1,1\n', 'line 2, x'),
    ('stamp,speed\n1,\n', 'line 2, speed'),
    ('stamp,speed\n1\n', 'line 2: found a different number of values')])
def test_faults_are_named(tmp_path, text, wanted):
    with pytest.raises(InputError, match=wanted):
        read_truth(written(tmp_path, text))


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match='readable'):
        read_truth(tmp_path / 'none.csv')


def test_stamps_other_than_whole_milliseconds_are_exact(tmp_path):
    # as floats both stamps are off by more than 100 ns: they have 53 bits for 61
    one, = read_truth(written(tmp_path, 'stamp,speed\n1700000000.123456,20\n'
                                        '1700000000.323456789,21\n'))
    assert one.stamps_ns.tolist() == [1_700_000_000_123_456_000, 1_700_000_000_323_456_789]
    assert one.speed_at([1_700_000_000_123_456_000]).tolist() == [20]
    assert np.isnan(one.speed_at([1_700_000_000_123_000_000])).all()
