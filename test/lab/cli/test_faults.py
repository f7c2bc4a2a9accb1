# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Output of nodes is compared with the right vehicle and time, by hand."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.io.truth import VehicleTruth
from stereo_speed.lab.cli.faults import _error, _pass_error, _row

SECOND, HOUR = 10 ** 9, 3600 * 10 ** 9
STAMPS = SECOND * np.arange(5)
# One brakes from 20 to 12 m/s, 40 m ahead on the left; one drives 30 m/s on the right.
TRUTH = [VehicleTruth(7, STAMPS, np.array([20.0, 18, 16, 14, 12]), np.tile([-3.0, 0, 40], (5, 1))),
         VehicleTruth(9, STAMPS, np.full(5, 30.0), np.tile([3.0, 0, 40], (5, 1)))]


def heard(*rows, off_ns=0):
    """Return received messages: positions of vehicle_0 at some rows of the truth."""
    return SimpleNamespace(places={
        (int(STAMPS[row]) + off_ns, 'vehicle_0'): (-2.5, 0.0, 41.0) for row in rows})


def told(speed, off_ns=0):
    """Return the message of a pass over all five stamps."""
    return {'track': 0, 'speed_mps': speed, 'speed_std_mps': 0.5, 'first_stamp_ns': off_ns,
            'last_stamp_ns': 4 * SECOND + off_ns}


@pytest.mark.parametrize('off_ns', [0, HOUR, -HOUR])
@pytest.mark.parametrize('rows', [(0, 1, 2, 3, 4), (0, 4), (0, 1), (3,), (1, 2, 4)])
def test_pass_is_compared_with_its_vehicle_over_its_time(rows, off_ns):
    """However few of its positions are published; also with stamps an hour off."""
    assert _pass_error(told(16.1, off_ns), heard(*rows, off_ns=off_ns), TRUTH) \
        == pytest.approx((0.1, 0.5))


def test_results_that_cannot_be_compared_are_left_out():
    assert _pass_error({**told(None)}, heard(0), TRUTH) is None
    assert _pass_error(told(16.0), heard(), TRUTH) is None


def test_reading_is_compared_with_the_vehicle_present_then():
    reading = SimpleNamespace(ns=3 * SECOND, frame_id='vehicle_0', speed_mps=14.5, std_mps=0.2)
    assert _error(reading, heard(3), TRUTH) == pytest.approx((0.5, 0.2))
    assert _error(reading, heard(2), TRUTH) is None


def test_worst_reading_in_sigmas_is_reported_even_if_none_is_wrong(capsys):
    """Errors of 0.5 m/s at a sigma of 0.1 against 1 m/s at 0.5; the truth is 14 and 16 m/s."""
    def reading(row, speed_mps, std_mps):
        return SimpleNamespace(at_s=10.0 + row, ns=row * SECOND, frame_id='vehicle_0',
                               speed_mps=speed_mps, std_mps=std_mps)
    said = heard(2, 3)
    said.readings = [reading(2, 17.0, 0.5), reading(3, 13.5, 0.1)]
    said.passes, said.levels = [], []
    row = _row('none', said, TRUTH, (10.0, 11.0, 5.0), True, True)
    assert (row.readings, row.wrong) == (2, 1)
    wrong, worst = capsys.readouterr().err.splitlines()
    assert wrong.startswith('none: wrong: vehicle_0 3.0 s after the start: ')
    assert worst == wrong.replace('wrong', 'worst reading') and '-5.0 sigma' in worst
    said.readings = said.readings[:1]
    assert _row('none', said, TRUTH, (10.0, 11.0, 5.0), True, True).wrong == 0
    assert 'off by +2.24, +2.0 sigma' in capsys.readouterr().err
    said.readings = []
    assert _row('none', said, TRUTH, (10.0, 11.0, 5.0), True, True).silent_s is None
    assert not capsys.readouterr().err
