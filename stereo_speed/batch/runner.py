# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Run independent jobs over the cores or a cluster, each once, and resume interrupted runs.

Every finished job is a line of ``runs.jsonl``. A job with such a line, the same parameters and the
same version of this package is not run again.
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
    Run the jobs that are not done yet, and return the results of all in the order of the jobs.

    A job that raises, or whose process dies, gives a result with the reason; a later run tries
    it again.

    :param jobs: the jobs.
    :param work: a module-level function that a worker process can import.
    :param out_dir: folder of ``runs.jsonl``; None keeps nothing.
    :param workers: number of processes; 0 runs the jobs in this process.
    :param description: label of the progress bar.
    :param cluster: address of a Dask scheduler, whose workers replace local processes.
    :param still_good: returns whether the files of an earlier run's job still exist.
    :raises InputError: two jobs have one key, the folder cannot be written, or another run is
        writing to it.
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
                # Set here, because new processes read the sources again, which may have changed.
                result = replace(result, fingerprint=prints[result.key])
                done[result.key] = result
                journal.append(asdict(result))
                bar.update()
    return [done[key] for key in keys]


def _spread_where(jobs: Sequence[Job], work: Work, workers: int, cluster: str
                  ) -> Iterator[Result]:
    """Run the jobs on a cluster, in processes, or in this one."""
    if cluster and jobs:
        from .cluster import spread_over_cluster  # an optional dependency
        return spread_over_cluster(jobs, work, cluster)
    return spread(jobs, work, workers) if workers > 0 else (attempt(job, work) for job in jobs)
