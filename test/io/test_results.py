# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The files of a run, byte for byte."""
from dataclasses import replace
import json
import math

import numpy as np
import pytest

from stereo_speed.core.errors import InputError
from stereo_speed.core.passes import (
    Direction, PassResult, SecondEstimate, SpeedBudget, VehicleClass, VehicleKind, Verdict)
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.io.atomic import prepare_folder
from stereo_speed.io.results import (
    passes_csv, software_versions, stream_timings, summary_json, tracks_csv, write_run)


def update(stamp_ns, track, speed_mps=24.5872, lane='near, slow'):
    return TrackUpdate(
        stamp_ns, track, lane, TrackState.CONFIRMED, speed_mps, 0.1, 12.0, -1e-9,
        np.array([1.0, 2.0, 30.123456]), np.eye(3), np.eye(3), np.zeros((4, 2)),
        np.zeros((4, 2)))


def result(track, verdict=Verdict.MEASURED, speed=24.58, reason=''):
    return PassResult(track, 'slow', 10, 20, 2, speed, None if speed is None else 0.03, verdict,
                      reason, {10: 24.5} if speed else {}, {10: 0.02} if speed else {})


def test_tracks_are_written_exactly():
    text = tracks_csv([update(20, 0), update(10, 1, math.nan), update(10, 0)], [result(0)])
    assert text == (
        'stamp_ns,track,lane,state,speed_mps,speed_std_mps,smoothed_mps,s_m,lateral_m,x_m,y_m,'
        'z_m\n'
        '10,0,"near, slow",confirmed,24.58720,0.10000,24.50000,12.00000,0.00000,1.00000,'
        '2.00000,30.12346\n'
        '10,1,"near, slow",confirmed,,0.10000,,12.00000,0.00000,1.00000,2.00000,30.12346\n'
        '20,0,"near, slow",confirmed,24.58720,0.10000,,12.00000,0.00000,1.00000,2.00000,'
        '30.12346\n')


def test_passes_are_written_exactly():
    budget = SpeedBudget(matching_mps=0.03, path_mps=0.04, stamps_mps=0.0, calibration_mps=0.12)
    measured = replace(result(2), budget=budget, end='lost', lane_to='fast',
                       second=SecondEstimate(24.6, 0.05, 9), direction=Direction.RECEDING,
                       vehicle=VehicleKind(VehicleClass.VAN, 0.97, 2.02, 0.08, None, None))
    without = replace(result(8, Verdict.REJECTED, None, 'lost'),
                      second=SecondEstimate(None, None, 2))
    text = passes_csv([result(7, Verdict.REJECTED, None, 'too_few_pairs'), measured, without])
    assert text == (
        'track,lane,first_ns,last_ns,pairs,speed_mps,speed_std_mps,verdict,reason,lane_to,end,'
        'first_mps,last_mps,max_mps,std_matching_mps,std_path_mps,std_stamps_mps,'
        'std_calibration_mps,second_mps,second_std_mps,second_pairs,direction,class,'
        'class_probability,width_m,width_std_m,height_m,height_std_m\n'
        '2,slow,10,20,2,24.58000,0.03000,measured,,fast,lost,24.50000,24.50000,24.50000,'
        '0.03000,0.04000,0.00000,0.12000,24.60000,0.05000,9,receding,van,0.97000,'
        '2.02000,0.08000,,\n'
        '7,slow,10,20,2,,,rejected,too_few_pairs,slow,stream_ended,,,,,,,,,,,,,,,,,\n'
        '8,slow,10,20,2,,,rejected,lost,slow,stream_ended,,,,,,,,,,2,,,,,,,\n')
    assert budget.total_mps == pytest.approx(0.13)


def test_summary_is_plain_sorted_json():
    text = summary_json({'b': np.float64(0.5), 'a': TrackerConfig(), 'c': np.arange(2),
                         'd': math.nan, 'e': Verdict.MEASURED, 'f': (True, None)})
    data = json.loads(text)
    assert list(data) == sorted(data)
    assert data['a']['particles'] == 400
    assert (data['b'], data['c'], data['d'], data['e'], data['f']) == (
        0.5, [0, 1], None, 'measured', [True, None])
    assert text.endswith('}\n')


def test_same_run_gives_the_same_bytes_and_no_other_files(tmp_path):
    for name, order in (('a', 1), ('b', -1)):
        write_run(tmp_path / name, [update(10, 0), update(20, 0)][::order],
                  [result(0), result(1)][::order], {'seed': 0, 'versions': software_versions()})
    names = ['passes.csv', 'summary.json', 'tracks.csv']
    assert sorted(p.name for p in (tmp_path / 'a').iterdir()) == names
    for name in names:
        assert (tmp_path / 'a' / name).read_bytes() == (tmp_path / 'b' / name).read_bytes()


def test_older_run_is_replaced_and_other_files_stay(tmp_path):
    for name in ('speed.png', 'road.png', 'holiday.png', 'tracks.csv', 'summary.json'):
        (tmp_path / name).write_text('old')
    write_run(tmp_path, [], [], {})
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        'holiday.png', 'passes.csv', 'summary.json', 'tracks.csv']
    assert (tmp_path / 'tracks.csv').read_text().startswith('stamp_ns,')


def test_failed_write_leaves_the_older_run(tmp_path):
    (tmp_path / 'tracks.csv').write_text('old')
    with pytest.raises(AttributeError):
        write_run(tmp_path, [object()], [], {})  # type: ignore[list-item]
    assert [p.name for p in tmp_path.iterdir()] == ['tracks.csv']


def test_folder_that_is_a_file(tmp_path):
    (tmp_path / 'out').write_text('')
    with pytest.raises(InputError, match='out: output folder: found File exists, wanted a wri'):
        prepare_folder(tmp_path / 'out')
    with pytest.raises(InputError, match='output folder'):
        write_run(tmp_path / 'out' / 'deeper', [], [], {})


def test_timings_equal_those_of_the_stream():
    facts = stream_timings([10**18, 10**18 + 200_000_000, 10**18 + 600_000_001])
    assert facts == {'pairs': 3, 'first_ns': 10**18, 'last_ns': 10**18 + 600_000_001,
                     'duration_s': 0.600000001, 'shortest_interval_s': 0.2,
                     'longest_interval_s': 0.400000001, 'mean_rate_hz': 3.333333}
    assert stream_timings([]) == {'pairs': 0}


def test_versions_are_text():
    found = software_versions()
    assert set(found) == {'stereo_speed', 'python', 'numpy', 'opencv', 'scipy', 'rosbags',
                          'kernels'}
    assert found['python'].count('.') == 1
    assert all(isinstance(v, str) and v for v in found.values())
