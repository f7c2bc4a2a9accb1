# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Records of simulated traffic against the truth: wrong ones are found, right ones pass."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.batch.job import Result
from stereo_speed.core.passes import PassResult, SecondEstimate, Verdict
from stereo_speed.core.records import InitialFront, TrackState, TrackUpdate
from stereo_speed.core.trace import PassTrace, TracePair
from stereo_speed.core.units import KMH_MPS
from stereo_speed.enforcement.config import DecisionConfig
from stereo_speed.enforcement.decision import decide
from stereo_speed.enforcement.record import Violation
from stereo_speed.lab.evaluation.violations import (
    DecidedStream, gather_violations, violation_jobs, violations_table)

LIMIT_MPS, SPEED_MPS, STEP_NS, COUNT = 50 * KMH_MPS, 72 * KMH_MPS, 100_000_000, 12


def truth(vehicle, side_m):
    """Return the position of a vehicle in each exposure, at 72 km/h."""
    return [{'vehicle': vehicle, 'stamp_ns': n * STEP_NS, 'speed': SPEED_MPS, 'x': side_m,
             'y': 1.0, 'z': 50 - 2.0 * n, 'in_view': True, 'width_px': 60.0, 'visible': 1.0}
            for n in range(COUNT)]


TRUTH = list(zip(truth(7, 0.0), truth(8, 3.7)))


def decided(kmh, place=lambda n: (0.1, 1.0, 50.3 - 2 * n), step_ns=STEP_NS):
    """Return a stream with a record of a speed, for a vehicle at given positions."""
    box = np.array([[0.0, 0], [10, 0], [10, 8], [0, 8]])
    update = TrackUpdate(0, 3, 'near', TrackState.CONFIRMED, 20.0, 0.1, 5.0, 0.0, np.zeros(3),
                         np.eye(3), np.eye(3), box, box)
    pairs = tuple(TracePair(n * step_ns, n * step_ns, None, None, replace(
        update, stamp_ns=n * step_ns, position_m=np.array(place(n)))) for n in range(COUNT))
    result = PassResult(
        track=3, lane='near', first_ns=0, last_ns=(COUNT - 1) * step_ns, pairs=COUNT,
        speed_mps=kmh * KMH_MPS, speed_std_mps=0.1, verdict=Verdict.MEASURED, reason='',
        smoothed={pair.stamp_ns: 20.0 for pair in pairs}, smoothed_std={})
    figures, _ = decide(result, LIMIT_MPS, DecisionConfig())
    trace = PassTrace(3, 0, 'near', InitialFront(0, box, box), 400, None, pairs)
    return DecidedStream([result], [Violation('r', result, trace, figures, [])],
                         {n * step_ns: n for n in range(COUNT)})


@pytest.mark.parametrize(('stream', 'speed', 'vehicle'), [
    (decided(72.0), 0, 0), (decided(74.9), 0, 0), (decided(69.2), 0, 0),
    (decided(75.1), 1, 0), (decided(68.9), 1, 0),
    (decided(72.0, lambda n: (3.5 if n == 6 else 0.0, 1.0, 50 - 2 * n)), 0, 1),  # next lane
    (decided(72.0, lambda n: (9.0, 1.0, 50 - 2 * n)), 1, 1),  # on nothing
    (decided(72.0, step_ns=STEP_NS // 2), 0, 0),  # stamps that a fault has changed
], ids=['right', '2.9 above', '2.8 below', '3.1 above', '3.1 below', 'other vehicle', 'nothing',
        'other stamps'])
def test_wrong_records_are_reported(stream, speed, vehicle):
    found = stream.scored('none', TRUTH, LIMIT_MPS)
    assert (found['wrong_speed'], found['wrong_vehicle']) == (speed, vehicle)
    assert len(found['details']) == max(speed, vehicle)
    assert found['violations'] == 2 and found['records'] == 1
    assert found['recorded'] == (0 if 'vehicles [-1' in str(found['details']) else 1)


def test_vehicle_within_the_limit_is_reported():
    found = decided(72.0).scored('none', TRUTH, 75 * KMH_MPS)
    assert (found['violations'], found['not_violating']) == (0, 1)


def test_every_fault_has_its_streams_and_its_row():
    jobs = violation_jobs(6, 0, ['none', 'black'])
    assert [job.parameters['fault'] for job in jobs] == ['none', 'black'] * 3
    assert len({str(job.parameters) for job in jobs}) == 6
    values = [decided(kmh).scored(job.parameters['fault'], TRUTH, LIMIT_MPS)
              for kmh, job in zip((72, 72, 76), jobs)]
    runs = gather_violations([Result(key=str(k), value=v) for k, v in enumerate(values)])
    rows = {row[0]: row for row in violations_table(runs).rows}
    columns = violations_table(runs).columns
    assert list(rows) == ['`none`', '`black`', 'all']
    assert rows['all'][columns.index('wrong speed')] == 1
    assert rows['`none`'][columns.index('worst error, km/h')] == pytest.approx(4.0)
    assert rows['all'][columns.index('share')] == '50 %'


def test_rejections_by_the_second_estimate_are_counted():
    stream = decided(72.0)
    apart = replace(stream.passes[0], second=SecondEstimate(18.0, 0.2, 8))
    none = replace(stream.passes[0], second=SecondEstimate(None, None, 2))
    stream.passes = [apart.rejected('second_estimate'), none.rejected('uncertain'), none]
    found = stream.scored('none', TRUTH, LIMIT_MPS)
    assert found['compared'] == 1
    row = violations_table([*gather_violations([Result(key='0', value=found)])]).rows[-1]
    assert row[-2:] == [1, 'second_estimate 1, uncertain 1']
