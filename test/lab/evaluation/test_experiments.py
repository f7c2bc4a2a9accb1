# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Planned runs: each once, with a name and everything it depends on."""
from __future__ import annotations

import os

import pytest
from stereo_speed.batch.job import Result
from stereo_speed.core.errors import InputError
from stereo_speed.lab.evaluation.experiments import (
    Experiment, plan, Runs, sequence_experiment, Source, track_job)
from stereo_speed.lab.evaluation.labeled_sequence import LineKnowledge
from stereo_speed.lab.evaluation.scorer import SequenceRun, VehicleRun


def files_of(sample):
    names = {'bag': 'bag', 'site': 'site.yaml', 'init': 'init.yaml', 'truth': 'truth.csv'}
    return {name: str(sample / file) for name, file in names.items()}


@pytest.mark.parametrize(('sequence', 'tracker'), [('moon', 'constrained'), ('curve28', 'luck')])
def test_unknown_names_are_refused(sequence, tracker):
    with pytest.raises(InputError, match=sequence if sequence == 'moon' else tracker):
        sequence_experiment(sequence, tracker)


@pytest.mark.parametrize('changes', [{'particles': 3}, {'parts': 5}, {'step_mps': -1.0}])
def test_parameters_out_of_bounds_are_refused_before_the_work(changes):
    with pytest.raises(InputError):
        sequence_experiment('curve28', 'constrained', **changes)


def test_key_names_sequence_lines_tracker_parameters_and_seed():
    experiment = sequence_experiment('curve28', 'kalman', particles=100,
                                     lines=LineKnowledge.EXACT)
    assert experiment.key(4) == \
        'curve28 exact kalman particles=100,speed_rate_std=0.33541 seed 4'
    bag = Experiment(source=Source(files={'bag': '/data/one/bag'}), tracker='flow')
    assert bag.key(0) == '/data/one/bag flow defaults seed 0'


def test_bag_is_named_after_its_folder():
    assert Source(files={'bag': '/data/one/bag'}).name == 'one'
    assert Source(files={'bag': '/data/two.mcap'}).name == 'two.mcap'
    assert Source(sequence='curve28').name == 'curve28'


def test_runs_on_one_sequence_and_seed_are_consecutive():
    a, b = (sequence_experiment('curve28', t) for t in ('constrained', 'kalman'))
    other = sequence_experiment('straight55', 'constrained')
    jobs = plan([(e, seed) for e in (a, other, b, a) for seed in (0, 1)])
    assert len(jobs) == 6
    runs = [job.group for job in jobs]
    assert len([i for i in range(1, 6) if runs[i] != runs[i - 1]]) == 3  # four groups


def test_job_changes_with_the_files_of_its_bag(sample, tmp_path):
    truth = tmp_path / 'truth.csv'
    truth.write_text('stamp,speed\n1,2\n')
    os.utime(truth, ns=(0, 0))
    source = Source(files={**files_of(sample), 'truth': str(truth)})
    experiment = Experiment(source=source, tracker='constrained')
    before = experiment.job(0).fingerprint
    assert experiment.job(0).fingerprint == before != experiment.job(1).fingerprint
    os.utime(truth, ns=(0, 1_000_000))
    assert experiment.job(0).fingerprint != before


def test_job_runs_on_a_bag(sample):
    experiment = Experiment(source=Source(files=files_of(sample)), tracker='flow',
                            changes={'particles': 50})
    run, = SequenceRun.from_json(track_job(experiment.job(0).parameters)).vehicles
    assert run.stamps_ns and all(t == pytest.approx(24.5872, abs=1e-3) for t in run.truth_mps)


def test_runs_by_experiment_seed_and_vehicle():
    a, b = (sequence_experiment('two_vehicles', t) for t in ('constrained', 'kalman'))
    results = [Result(key=e.key(seed), value=SequenceRun(cpu_ms=ms, vehicles=[
        VehicleRun(vehicle=n, pairs=seed) for n in (0, 1)]).to_json())
        for e, seed, ms in ((a, 0, 2.0), (a, 1, 4.0), (b, 0, 9.0))]
    runs = Runs(results + [Result(key=b.key(1), error='no road')])
    assert [run.pairs for run in runs.vehicle(a, range(2), 1)] == [0, 1]
    assert len(runs.of(b, range(2))) == 1
    assert runs.vehicles(a, [0]) == [0, 1] and runs.vehicles(a, [7]) == []
    assert runs.cpu_ms(a, range(2)) == 3.0
    assert runs.cpu_ms(a, [7]) != runs.cpu_ms(a, [7])  # not a number
