# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Jobs run once each in worker processes, through failures, crashes and truncated lines."""
from __future__ import annotations

from collections import deque
from dataclasses import replace
import importlib
import json
import multiprocessing
from pathlib import Path

import pytest

from stereo_speed.batch.job import failures, Job, source_hash
from stereo_speed.batch.journal import JOURNAL, Journal
from stereo_speed.batch.processes import give_next, spread
from stereo_speed.batch.runner import run_jobs
from stereo_speed.core.errors import InputError


@pytest.fixture
def work(monkeypatch):
    """Return the worker from a module that worker processes can import."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    return importlib.import_module('squaring').work


def jobs_of(count, trace='', **changes):
    """Make jobs; changes to some are given by their keys."""
    plain = [{'n': n, 'trace': str(trace)} for n in range(count)]
    return [Job(key=f'job{n}', parameters={**row, **changes.get(f'job{n}', {})})
            for n, row in enumerate(plain)]


def squares(results):
    """Return the values of results."""
    return [None if r.value is None else r.value['square'] for r in results]


@pytest.mark.parametrize('workers', [0, 2])
def test_results_are_in_the_order_of_the_jobs(workers, work):
    results = run_jobs(jobs_of(7), work, out_dir=None, workers=workers, description='squares')
    assert [r.key for r in results] == [f'job{n}' for n in range(7)]
    assert squares(results) == [n ** 2 for n in range(7)]


def test_only_missing_or_changed_jobs_are_run(tmp_path, work):
    trace = tmp_path / 'trace'

    def run(jobs):
        trace.write_text('')
        results = run_jobs(jobs, work, out_dir=tmp_path, workers=0, description='squares')
        return squares(results), [line.split()[0] for line in trace.read_text().splitlines()]
    assert run(jobs_of(2, trace)) == ([0, 1], ['0', '1'])
    assert run(jobs_of(4, trace)) == ([0, 1, 4, 9], ['2', '3'])
    assert run(jobs_of(4, trace, job1={'n': 5})) == ([0, 25, 4, 9], ['5'])


def test_results_of_other_code_are_not_reused(tmp_path, work):
    trace = tmp_path / 'trace'
    run_jobs(jobs_of(1, trace), work, out_dir=tmp_path, workers=0, description='squares')
    journal = tmp_path / JOURNAL
    row = json.loads(journal.read_text())
    journal.write_text(json.dumps({**row, 'fingerprint': 'f' * 16}) + '\n')
    run_jobs(jobs_of(1, trace), work, out_dir=tmp_path, workers=0, description='squares')
    assert len(trace.read_text().splitlines()) == 2


def test_code_is_identified_by_its_files_and_their_names(tmp_path):
    def hashed(folder, **files):
        (tmp_path / folder).mkdir()
        for name, text in files.items():
            (tmp_path / folder / f'{name}.py').write_text(text)
        return source_hash(tmp_path / folder)
    same = [hashed(folder, a='x = 1') for folder in ('one', 'two')]
    assert same[0] == same[1]
    assert len({*same, hashed('three', a='x = 2'), hashed('four', b='x = 1'),
                hashed('five', a='x = 1', b='')}) == 4


def test_failure_is_recorded_and_retried(tmp_path, work):
    bad = {'job1': {'fail': 'no road\nhere'}, 'job2': {'refuse': True}}
    results = run_jobs(jobs_of(4, **bad), work, out_dir=tmp_path, workers=0,
                       description='squares')
    assert squares(results) == [0, None, None, 9]
    reasons = failures(results)
    assert len(reasons) == 2
    assert reasons[0].startswith('job1: ValueError: no road here (squaring.py:')
    assert reasons[1] == 'job2: scene: lane: found 7, wanted below 3'
    journal = tmp_path / JOURNAL
    again = [replace(job, parameters=json.loads(json.dumps(job.parameters)))
             for job in jobs_of(4, **bad)]
    before = len(journal.read_text().splitlines())
    run_jobs(again, work, out_dir=tmp_path, workers=0, description='squares')
    assert len(journal.read_text().splitlines()) == before + 2


def test_dead_process_loses_only_one_job(work):
    results = run_jobs(jobs_of(5, job1={'die': True}), work, out_dir=None, workers=2,
                       description='squares')
    assert squares(results) == [0, None, 4, 9, 16]
    assert results[1].error == 'its process ended with status -9'


class StandIn:
    """A worker that takes jobs and does nothing."""

    def __init__(self):
        self.waiting, self.given = deque(), []

    def give(self, job):
        self.given.append(job.key)


def deal(groups, turns):
    """Hand out the jobs of groups to two workers that ask in a given order."""
    queue = deque(deque(Job(key=key, parameters={}) for key in group) for group in groups)
    pool = [StandIn(), StandIn()]
    for turn in turns:
        give_next(pool[turn], queue, pool)
    return [''.join(worker.given) for worker in pool]


def test_group_stays_with_one_worker_until_others_would_idle():
    assert deal(['abcd', 'efgh'], [0, 1] * 4) == ['abcd', 'efgh']
    # the first finishes its group while e is running, and takes the end of the rest
    assert deal(['abcd', 'efgh'], [1, 0, 0, 0, 0, 0, 0, 1, 1]) == ['efghcd', 'ab']
    assert deal(['ab', 'cdef'], [0, 1, 0, 0, 0, 1, 0]) == ['abef', 'cd']


def test_job_of_a_truncated_line_is_run_again(tmp_path, work):
    run_jobs(jobs_of(3), work, out_dir=tmp_path, workers=0, description='squares')
    journal = tmp_path / JOURNAL
    journal.write_text(journal.read_text()[:-20])
    results = run_jobs(jobs_of(3), work, out_dir=tmp_path, workers=0, description='squares')
    assert squares(results) == [0, 1, 4]
    with Journal(tmp_path) as kept:
        assert sorted(kept.rows()) == ['job0', 'job1', 'job2']


def test_keys_are_unique(work):
    with pytest.raises(InputError, match='same key'):
        run_jobs(jobs_of(2)[:1] * 2, work, out_dir=None, workers=0, description='squares')


def test_interrupt_ends_the_processes(work):
    before = set(multiprocessing.active_children())
    results = spread(jobs_of(6), work, 2)
    next(results)
    started = set(multiprocessing.active_children()) - before
    assert len(started) == 2
    with pytest.raises(KeyboardInterrupt):
        results.throw(KeyboardInterrupt())
    assert not any(process.is_alive() for process in started)
