# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The scoring of long live runs, with synthetic vehicles and samples."""
from __future__ import annotations

import mmap
import os
import time

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.units import MPH_MPS
from stereo_speed.io.truth import VehicleTruth
from stereo_speed.lab.evaluation.soak import (
    counted_vehicles, Held, lost_pairs, Rounds, Sample, sample_of, Soaked, SoakRules)

SECOND = 10 ** 9
START, ROUND = 100 * SECOND, 60 * SECOND


def vehicle(number, first_s, side_m):
    """Return a vehicle that approaches at 10 m/s for three seconds."""
    stamps = START + (first_s * SECOND + np.arange(30) * SECOND // 10)
    z_m = 60.0 - 10.0 * np.arange(30) * 0.1
    return VehicleTruth(number, stamps, np.full(30, 10.0),
                        np.stack([np.full(30, side_m), np.zeros(30), z_m], axis=-1))


TRUTH = (vehicle(0, 5, 0.0), vehicle(1, 5, 12.0), vehicle(2, 30, 0.0))


def passes(truth, turn, speed=10.0, verdict='measured', off_m=0.5):
    """Return a pass of a vehicle in a round, and the positions of its track."""
    places = [(int(ns) + turn * ROUND, tuple(at + [off_m, 0, 0]))
              for ns, at in zip(truth.stamps_ns, truth.position_m)]
    return ({'verdict': verdict, 'first_stamp_ns': places[0][0],
             'last_stamp_ns': places[-1][0], 'speed_mps': speed,
             'reason': '' if verdict == 'measured' else 'too_few_pairs'}, places)


def test_each_vehicle_of_each_round_is_counted():
    rounds = Rounds(TRUTH, {0, 1}, ROUND, START)
    for turn in (0, 1):
        rounds.add(*passes(TRUTH[0], turn))
    rounds.add(*passes(TRUTH[0], 1, speed=10.2))  # measured a second time
    rounds.add(*passes(TRUTH[1], 0, verdict='rejected'))
    rounds.add(*passes(TRUTH[2], 0))  # measured, though it does not count
    rounds.add(*passes(TRUTH[1], 1, off_m=30.0))  # on no vehicle
    assert rounds.counts(2) == {'vehicles': 4, 'once': 1, 'more': 1, 'rejected': 1, 'missed': 1,
                                'astray': 1}
    assert rounds.errors_mps == pytest.approx([0.0, 0.0, 0.2, 0.0])
    assert rounds.wrong(SoakRules(wrong_mps=0.1)) == 1 and rounds.wrong(SoakRules()) == 0
    assert rounds.reasons == {'too_few_pairs': 1}


def test_pairs_without_a_result_are_lost():
    stamps = [START, START + SECOND, START + 2 * SECOND]
    found = [ns + turn * ROUND for turn in range(3) for ns in stamps]
    assert lost_pairs(found, stamps, ROUND, 3) == (9, 0)
    assert lost_pairs(found[:4] + found[5:], stamps, ROUND, 3) == (9, 1)


def samples(memory, handles=lambda k: 20):
    return [Sample(at_s=float(k), memory_mb=memory(k), handles=handles(k), threads=5)
            for k in range(101)]


@pytest.mark.parametrize(('made', 'fault'), [
    (samples(lambda k: 100.0), ''),
    (samples(lambda k: 100.0 + min(k, 20)), ''),  # grows while it warms up
    (samples(lambda k: 100.0 + k / 5), 'memory grew by 15.0 MB'),
    (samples(lambda k: 100.0, lambda k: 20 + k // 10), 'handles grew from 22 to 30'),
], ids=['flat', 'warm', 'leak', 'files'])
def test_growth_is_reported(made, fault):
    rules = SoakRules(warm_share=0.25, growth_mb=10.0, handles=3)
    assert ''.join(Held.of('node', made, rules).faults(rules)).startswith(
        fault and f'node: {fault}')
    with pytest.raises(InputError, match='3 samples'):
        Held.of('node', made[:3], rules)


def test_run_is_good_or_its_faults_are_listed():
    rounds = Rounds(TRUTH, {0}, ROUND, START)
    rounds.add(*passes(TRUTH[0], 0))
    flat = Held.of('node', samples(lambda k: 100.0), SoakRules())
    sound = Soaked(minutes=1.0, pairs=(9, 0), delays_s=[0.1, 0.3], reading_delays_s=[0.1] * 3,
                   readings=7, rounds=rounds, played=1, held=[flat])
    assert sound.faults(SoakRules()) == []
    cells = sound.table().markdown().splitlines()[-1].strip('| ').split(' | ')
    assert cells == ['1.0', '9', '0', '1', '1', '0', '0', '0', '0', '0.00', '7']
    assert [line.strip('| ').split(' | ')
            for line in sound.delays_table().markdown().splitlines()[-2:]] == [
        ['live readings', '0.100', '0.100', '0.100', '0.100'],
        ['all tracks of a pair', '0.200', '0.290', '0.298', '0.300']]
    worse = Soaked(minutes=1.0, pairs=(9, 2), delays_s=[], readings=7, rounds=rounds, played=2,
                   held=[flat])
    assert worse.faults(SoakRules()) == ['2 of 9 pairs were lost',
                                         '1 of 2 vehicles were measured once']


def test_wrong_readings_are_counted():
    rounds = Rounds(TRUTH, {0}, ROUND, START)
    told, places = passes(TRUTH[0], 1)
    ns = [at for at, _ in places]
    # off by 0.9 m/s with 0.1 (more than 1 mph and 4 sigma would be wrong), by 0.5 with 0.05
    # (10 sigma), by 1 m/s with 0.5 (2 sigma), right; and one without truth
    rounds.add(told, places, [(ns[3], 10.9, 0.1), (ns[4], 9.5, 0.05), (ns[5], 11.0, 0.5),
                              (ns[6], 10.0, 0.1), (ns[6] + SECOND // 20, 20.0, 0.1)])
    assert len(rounds.reading_errors) == 4 and not rounds.readings_astray
    assert rounds.wrong_readings(SoakRules()) == 2
    assert rounds.wrong_readings(SoakRules(reading_mps=0.95)) == 0
    assert rounds.worst_reading == (pytest.approx(1.0 / MPH_MPS), pytest.approx(10.0))
    told, places = passes(TRUTH[1], 1, verdict='rejected', off_m=30.0)
    rounds.add(told, places, [(ns[3], 10.0, 0.1)] * 2)
    assert rounds.readings_astray == 2
    run = Soaked(minutes=1.0, pairs=(9, 0), rounds=rounds, played=0, held=[])
    assert run.faults(SoakRules()) == [
        '2 live readings are off by more than 0.45 m/s and 4 sigma',
        '2 live readings on no vehicle']


def test_delay_of_readings_is_judged_on_request():
    def faults(p95_ms, *delays_s):
        return Soaked(minutes=1.0, pairs=(9, 0), reading_delays_s=delays_s, played=0, held=[],
                      rounds=Rounds(TRUTH, set(), ROUND, START)).faults(SoakRules(p95_ms=p95_ms))
    late = (0.02,) * 15 + (0.07,) * 5
    assert faults(None, *late) == faults(71, *late) == faults(60, *late[:15]) == []
    assert faults(60, *late) == [
        '95th percentile of the delay of live readings is 70.0 ms, at most 60 are allowed']
    assert faults(60) == ['there is no live reading whose delay could be judged']


def test_overload_on_purpose_may_skip_pairs_but_not_measure_wrong():
    rounds = Rounds(TRUTH, {0, 1}, ROUND, START)
    told, places = passes(TRUTH[0], 0)
    rounds.add(told, places, [(places[3][0], 10.2, 0.1)])
    run = Soaked(minutes=1.0, pairs=(9, 5), reading_delays_s=[0.2, 1.5], readings=1,
                 rounds=rounds, played=1, held=[], skipped=5, hurried=3, overloaded=True)
    assert run.faults(SoakRules()) == []
    assert run.faults(SoakRules(reading_mps=0.1, reading_sigmas=1)) == [
        '1 live readings are off by more than 0.10 m/s and 1 sigma']
    assert 'NOT JUDGED: the nodes were overloaded on purpose' in run.notes(SoakRules())[0]
    assert run.readings_table(SoakRules()).markdown().splitlines()[-1].strip('| ').split(
        ' | ') == ['5', '3', '1.50', '1', '0', '0', '0.45', '2.0', '1', '0']


def test_memory_is_not_judged_while_pairs_wait():
    leak = Held.of('node', samples(lambda k: 100.0 + k), SoakRules())

    def run(*delays_s):
        return Soaked(minutes=1.0, pairs=(9, 0), delays_s=delays_s, readings=7,
                      rounds=Rounds(TRUTH, set(), ROUND, START), played=1, held=[leak])
    assert len(run(0.1, 1.0).faults(SoakRules())) == 1 and not run(0.1, 1.0).notes(SoakRules())
    assert not run(0.1, 9.0).faults(SoakRules())
    assert 'NOT JUDGED' in run(0.1, 9.0).notes(SoakRules())[0]


def test_state_of_a_process_is_read():
    before = sample_of(os.getpid(), time.monotonic())
    # memory from the system, not memory that the process had freed
    with mmap.mmap(-1, 30 * 2 ** 20, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) as block, \
            open(os.devnull) as one, open(os.devnull) as other:
        for _ in range(30):
            block.write(bytes(2 ** 20))
        after = sample_of(os.getpid(), time.monotonic())
        assert after.handles - before.handles == len([one, other])
    assert 25 < after.memory_mb - before.memory_mb < 40


def test_only_well_visible_vehicles_count(sample, tmp_path):
    """All vehicles of the sample's file count, because it has no visibility."""
    assert counted_vehicles(sample / 'truth.csv', (TRUTH[1],)) == {1}
    path = tmp_path / 'truth.csv'
    rows = [f'{100 + k / 5},{v},80.0,{visible},1' for k in range(9)
            for v, visible in ((0, 1.0), (1, 0.2))]
    path.write_text('\n'.join(['stamp,vehicle,width_px,visible,in_view', *rows]))
    assert counted_vehicles(path, TRUTH[:2]) == {0}
