# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Run independent jobs over the cores or a cluster, once each, and resumably.

Every finished job is a line of ``runs.jsonl``; a job whose line is there with the same parameters
and the same version of this package is not run again.
"""
from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Callable, Iterator, Sequence, Union

from tqdm import tqdm

from .job import attempt, Job, Result, Work
from .journal import Journal
from .processes import spread
from ..core.errors import InputError


def run_jobs(jobs: Sequence[Job], work: Work, *, out_dir: Union[str, Path, None],
             workers: int, description: str, cluster: str = '',
             still_good: Callable[[Result], bool] = lambda result: True) -> list[Result]:
    """
    Run the jobs that are not done yet and return the results of all, in the order of the jobs.

    A job that raises, or whose process dies, gives a result with its reason; a later run tries
    it again.

    :param jobs: the jobs.
    :param work: a function of a module: a process of its own imports it.
    :param out_dir: folder that keeps ``runs.jsonl``; None keeps nothing.
    :param workers: number of processes; 0 runs the jobs in this one.
    :param description: label of the progress bar.
    :param cluster: address of a Dask scheduler, whose workers take the place of processes here.
    :param still_good: whether what an earlier run has left of a job is still there.
    :raises InputError: two jobs with one key, a folder that cannot be written or that another
        run is writing.
    """
    keys = [job.key for job in jobs]
    if len(set(keys)) < len(keys):
        raise InputError(description, 'jobs', 'two with the same key', 'a key for each job')
    prints = {job.key: job.fingerprint for job in jobs}
    with Journal(out_dir) as journal:
        done = {key: Result(**row) for key, row in journal.rows().items()
                if row.get('fingerprint') == prints.get(key, '') and not row.get('error')}
        done = {key: result for key, result in done.items() if still_good(result)}
        missing = [job for job in jobs if job.key not in done]
        with tqdm(total=len(jobs), initial=len(done), desc=description, unit='run',
                  disable=None, smoothing=0.1) as bar:
            for result in _spread_where(missing, work, workers, cluster):
                # Set here: the sources may have changed since, and processes read them anew.
                result = replace(result, fingerprint=prints[result.key])
                done[result.key] = result
                journal.append(asdict(result))
                bar.update()
    return [done[key] for key in keys]


def _spread_where(jobs: Sequence[Job], work: Work, workers: int, cluster: str
                  ) -> Iterator[Result]:
    """Run the jobs on a cluster, in processes, or in this one."""
    if cluster and jobs:
        from .cluster import spread_over_cluster  # an extra: only who asks for it needs it
        return spread_over_cluster(jobs, work, cluster)
    return spread(jobs, work, workers) if workers > 0 else (attempt(job, work) for job in jobs)
