# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Run independent jobs on the workers of a Dask cluster.

Dask gives the job of a dead worker to another one, a few times; a job that kills every worker is
given up with its reason. All machines must see the files under the same paths, and run the same
code.
"""
from __future__ import annotations

import logging
import os
import threading
from typing import Any, Iterator, Sequence

import cv2

from .job import attempt, Job, Result, source_hash, Work
from ..core.errors import InputError
from ..core.threads import VARIABLES

_CONNECT_S = 60  # timeout for the scheduler, and for its first worker
_one_job = threading.Lock()  # one job per process, because a worker may have several threads


def spread_over_cluster(jobs: Sequence[Job], work: Work, address: str) -> Iterator[Result]:
    """
    Run the jobs on a cluster, and yield the results as they arrive.

    Jobs that have not started when the generator ends are cancelled.

    :param jobs: the jobs.
    :param work: a module-level function that the workers can import.
    :param address: address of the scheduler, as ``tcp://host:8786``.
    :raises InputError: Dask is not installed, or there is no scheduler or no worker.
    """
    try:
        from distributed import as_completed, Client
    except ModuleNotFoundError:
        raise InputError('--dask', 'Python module', 'no distributed',
                         "the extra: pip install 'stereo_speed[cluster]'") from None
    # Results report failures in one line, so Dask's own logs are silenced.
    for name in ('distributed', *logging.root.manager.loggerDict):  # each has its own level
        if name.split('.')[0] == 'distributed':
            logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError('--dask', 'scheduler', f'{address} ({type(error).__name__})',
                         'the address of a running one, as tcp://host:8786') from None
    try:
        _await_worker(client, address)
        futures = {client.submit(_on_worker, job, work, source_hash(), pure=False): job
                   for job in jobs}
        for future in as_completed(list(futures), loop=client.loop):
            yield _result(future, futures[future])
            future.release()
    finally:
        client.close(timeout=_CONNECT_S)


def _await_worker(client: Any, address: str) -> None:
    """Wait for a worker, and raise after a timeout instead of waiting for ever."""
    try:
        client.wait_for_workers(1, timeout=_CONNECT_S)
    except TimeoutError:
        raise InputError('--dask', 'workers', f'none at {address}', 'at least one') from None


def _result(future: Any, job: Job) -> Result:
    """Return the result of a job, also where it failed in any way."""
    try:
        result: Result = future.result()
        return result
    except BaseException as error:  # CancelledError is no Exception
        if isinstance(error, (KeyboardInterrupt, SystemExit)):
            raise
        told = ' '.join(str(error).split())[:300]
        return Result(key=job.key, error=f'{type(error).__name__}: {told}')


def _on_worker(job: Job, work: Work, source: str) -> Result:
    """Run one job in a worker's process: one at a time, on one thread, with the same code."""
    with _one_job:
        if source_hash() != source:
            return Result(key=job.key, error='worker: stereo_speed: found other code there, '
                                             'wanted the same version on all machines')
        if not any(os.environ.get(name) == '1' for name in VARIABLES):
            return Result(key=job.key, error=f'worker: {VARIABLES[0]}: found '
                          f'{os.environ.get(VARIABLES[0], "nothing")}, wanted 1, as its nanny '
                          'sets it')
        cv2.setNumThreads(1)
        return attempt(job, work)
