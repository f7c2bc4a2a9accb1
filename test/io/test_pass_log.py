# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The SQLite file of passes: its content, and its durability."""
from __future__ import annotations

import json
import os
import signal
import sqlite3
import subprocess
import sys

import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.passes import (
    Direction, PassResult, SecondEstimate, VehicleClass, VehicleKind, Verdict)
from stereo_speed.io.pass_json import pass_text
from stereo_speed.io.pass_log import PassLog
from stereo_speed.io.pass_rows import read_vehicles


def text(track, speed_mps=24.5, run='r'):
    result = PassResult(track, 'near', 10, 20, 5, speed_mps, None if speed_mps is None else 0.1,
                        Verdict.MEASURED if speed_mps else Verdict.REJECTED,
                        '' if speed_mps else 'uncertain', {}, {}, direction=Direction.RECEDING,
                        second=SecondEstimate(24.6, 0.2, 4),
                        vehicle=VehicleKind(VehicleClass.CAR, 0.98, 1.8, 0.08))
    return pass_text(run, result)


def rows(path, what='*', table='passes'):
    database = sqlite3.connect(path)
    try:
        return database.execute(f'SELECT {what} FROM {table}').fetchall()
    finally:
        database.close()


def test_passes_and_readings_are_stored_once_during_writing(tmp_path):
    path = tmp_path / 'log.sqlite'
    with PassLog(path) as log:
        assert log.add_pass(text(0)) and log.add_pass(text(1, None))
        assert not log.add_pass(text(0))  # the topic repeats late ones
        log.add_track(10, 'vehicle_0', 24.4, 0.2, (1.0, 2.0, 30.0))
        log.add_track(10, 'vehicle_1', None, None, (1.0, 2.0, 30.0))
        assert len(rows(path)) == 2  # another connection, while this one is open
        log.keep()
        assert rows(path, 'vehicle, speed_mps, z_m', 'tracks') == [
            ('vehicle_0', 24.4, 30.0), ('vehicle_1', None, 30.0)]
    with PassLog(path) as log:
        assert log.add_pass(text(0, run='another'))
    assert rows(path, 'id, direction, speed_mps, second_mps, second_pairs, reason') == [
        ('r-000000', 'receding', 24.5, 24.6, 4, ''), ('r-000001', 'receding', None, 24.6, 4,
                                                      'uncertain'),
        ('another-000000', 'receding', 24.5, 24.6, 4, '')]
    assert json.loads(rows(path, 'json')[0][0])['speed_mps'] == 24.5
    assert rows(path, 'class, class_probability')[0] == ('car', 0.98)
    assert {v.kind for v in read_vehicles([path])} == {'car'}
    assert [v.speed_mps for v in read_vehicles([path])] == [24.5, 24.5, None]


WRITER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from test_pass_log import text
from stereo_speed.io.pass_log import PassLog
log, track = PassLog(Path(sys.argv[1])), 0
while True:
    log.add_track(track, 'vehicle', 1.0, 0.1, (0, 0, 1))
    log.add_pass(text(track))
    print(track, flush=True)
    track += 1
"""


@pytest.mark.slow
@pytest.mark.parametrize('after', [1, 8, 27])
def test_killed_writer_loses_no_committed_pass(tmp_path, after):
    path = tmp_path / 'log.sqlite'
    writer = subprocess.Popen([sys.executable, '-c', WRITER, str(path), os.path.dirname(__file__)],
                              stdout=subprocess.PIPE, text=True)
    told = -1
    while told < after:
        told = int(writer.stdout.readline())
    writer.send_signal(signal.SIGKILL)
    told = max([told, *map(int, writer.stdout.read().split())])
    writer.wait(10)
    tracks = [track for track, in rows(path, 'track')]
    assert tracks[:told + 1] == list(range(told + 1)) and len(tracks) <= told + 2
    assert rows(path, '*', 'pragma_integrity_check') == [('ok',)]
    with PassLog(path) as log:
        assert log.add_pass(text(10 ** 6))


def test_other_files_and_texts_are_refused_in_one_line(tmp_path):
    (tmp_path / 'notes').write_text('no database at all, but quite a few words' * 40)
    with pytest.raises(InputError, match='notes: database: found file is not a database'):
        PassLog(tmp_path / 'notes')
    other = sqlite3.connect(tmp_path / 'other.sqlite')
    other.execute('CREATE TABLE passes (a)')
    other.close()
    with pytest.raises(InputError, match='table passes: found a'):
        PassLog(tmp_path / 'other.sqlite')
    with PassLog(tmp_path / 'log.sqlite') as log:
        for bad in ('', '[]', '{}', '[' * 100000, text(0).replace('"stereo_speed_pass": 1',
                                                                  '"stereo_speed_pass": 2'),
                    text(0).replace('"track": 0', f'"track": {2 ** 63}'),
                    text(0).replace('"lane": "near"', r'"lane": "\ud800"'),
                    text(0).replace('"lane": "near"', '"lane": ["near"]'),
                    text(0).replace('"track": 0', '"track": {}')):
            assert bad != text(0)
            with pytest.raises(InputError, match='^pass: '):
                log.add_pass(bad)
