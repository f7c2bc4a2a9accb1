# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The judge of long live runs, with invented vehicles and samples."""
from __future__ import annotations

import mmap
import os
import time

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
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
    """Return a pass of a vehicle in a round, and the places of its track."""
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
    rounds.add(*passes(TRUTH[2], 0))  # measured, though not required
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
    # from the system, not from what the process has freed before
    with mmap.mmap(-1, 30 * 2 ** 20, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) as block, \
            open(os.devnull) as one, open(os.devnull) as other:
        for _ in range(30):
            block.write(bytes(2 ** 20))
        after = sample_of(os.getpid(), time.monotonic())
        assert after.handles - before.handles == len([one, other])
    assert 25 < after.memory_mb - before.memory_mb < 40


def test_only_well_visible_vehicles_count(sample, tmp_path):
    """In a file without visibility, such as the sample's, all count."""
    assert counted_vehicles(sample / 'truth.csv', (TRUTH[1],)) == {1}
    path = tmp_path / 'truth.csv'
    rows = [f'{100 + k / 5},{v},80.0,{visible},1' for k in range(9)
            for v, visible in ((0, 1.0), (1, 0.2))]
    path.write_text('\n'.join(['stamp,vehicle,width_px,visible,in_view', *rows]))
    assert counted_vehicles(path, TRUTH[:2]) == {0}
