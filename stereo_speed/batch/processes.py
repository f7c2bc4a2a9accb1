# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Run independent jobs in processes of this machine.

Each worker process takes whole groups of jobs, so that data shared by a group (a rendered
sequence) are made once. A process that dies fails only its current job and is replaced.
"""
from __future__ import annotations

from collections import deque
from multiprocessing import connection, get_context, parent_process
from multiprocessing.connection import Connection
import os
import signal
import threading
from typing import Any, Iterator, Optional, Sequence

import cv2
from tqdm import tqdm

from .job import attempt, Job, Result, Work
from ..core.threads import one_blas_thread

_JOIN_S = 5.0  # timeout for the end of a process


def _serve(pipe: Connection[Any, Any], work: Work) -> None:
    """Run in a worker process: receive jobs and send results, until None is received."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends the run
    cv2.setNumThreads(1)  # the jobs occupy all cores
    # tqdm's default lock is a system semaphore, which would survive a killed process
    tqdm.set_lock(threading.RLock())
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        while (job := pipe.recv()) is not None:
            pipe.send(attempt(job, work))
    except (EOFError, OSError):  # the parent is gone
        pass


def _end_with_parent() -> None:
    """End this process when its parent ends, so that no job outlives its run and writes later."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


class Worker:
    """
    A process, and the jobs that wait for it.

    :param work: the function that it runs for each job.
    """

    def __init__(self, work: Work) -> None:
        one_blas_thread()
        context = get_context('spawn')
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, work), daemon=True)
        self.process.start()
        theirs.close()
        self.waiting: deque[Job] = deque()
        self.job: Optional[Job] = None

    def give(self, job: Job) -> None:
        """Send a job."""
        self.job = job
        try:
            self.pipe.send(job)
        except OSError:  # it died while idle; take() will notice
            pass

    def take(self) -> tuple[Result, bool]:
        """Receive the result of the current job, and whether the process is still alive."""
        job, self.job = self.job, None
        if job is None:
            raise RuntimeError('no job in hand')
        try:
            result: Result = self.pipe.recv()
            return result, True
        except (EOFError, OSError):
            self.process.join(_JOIN_S)
            return Result(key=job.key, error=(
                f'its process ended with status {self.process.exitcode}')), False

    def stop(self) -> None:
        """End the process at once."""
        self.process.terminate()
        self.process.join(_JOIN_S)
        self.pipe.close()


def spread(jobs: Sequence[Job], work: Work, workers: int) -> Iterator[Result]:
    """
    Run the jobs in processes, and yield the results as they arrive.

    The processes end with the generator.
    """
    groups: dict[str, deque[Job]] = {}
    for job in jobs:
        groups.setdefault(job.group or job.key, deque()).append(job)
    queue = deque(groups.values())
    pool = [Worker(work) for _ in range(min(workers, len(jobs)))]
    try:
        for worker in pool:
            give_next(worker, queue, pool)
        while busy := [worker for worker in pool if worker.job is not None]:
            ready = connection.wait([worker.pipe for worker in busy])
            for worker in (worker for worker in busy if worker.pipe in ready):
                result, alive = worker.take()
                if not alive:
                    fresh = Worker(work)
                    fresh.waiting = worker.waiting
                    pool[pool.index(worker)] = fresh
                    worker.stop()
                    worker = fresh
                yield result
                give_next(worker, queue, pool)
    finally:
        for worker in pool:
            worker.stop()


def give_next(worker: Worker, queue: deque[deque[Job]], pool: Sequence[Worker]) -> None:
    """Give a worker its next job: from its group, from a new one, or from half of another's."""
    if not worker.waiting and queue:
        worker.waiting = queue.popleft()
    if not worker.waiting:
        longest = max((other.waiting for other in pool), key=len)
        for _ in range((len(longest) + 1) // 2):
            worker.waiting.appendleft(longest.pop())
    if worker.waiting:
        worker.give(worker.waiting.popleft())
