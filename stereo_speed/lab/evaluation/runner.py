# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Run independent jobs over the cores, once each: resumable, whatever becomes of one of them.

Each worker process takes whole groups of jobs, so that what the jobs of a group share (a rendered
sequence) is made once. Every finished job is a line of ``runs.jsonl``; a job whose line is there
with the same parameters and the same version of this package is not run again.
"""
from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
import hashlib
import json
from multiprocessing import connection, get_context
from multiprocessing.connection import Connection
from pathlib import Path
import signal
import time
import traceback
from typing import Any, Callable, Iterator, Mapping, Optional, Sequence, Union

import cv2
from tqdm import tqdm

from .journal import Journal
from ... import __version__
from ...core.errors import InputError, StereoSpeedError
from ...core.threads import one_blas_thread

Value = Mapping[str, Any]
Work = Callable[[Value], Value]
_JOIN_S = 5.0  # longest wait for a process to end


@dataclass(frozen=True, kw_only=True)
class Job:
    """
    One job.

    :param key: names it, once among the jobs of a run.
    :param parameters: what the work gets; JSON values only, with all the job depends on.
    :param group: jobs of one group run in one process as far as possible; its own by default.
    """

    key: str
    parameters: Value
    group: str = ''

    @property
    def fingerprint(self) -> str:
        """Hash of the parameters and of this package, which the result follows from."""
        text = json.dumps([self.parameters, source_hash()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True, kw_only=True)
class Result:
    """
    What came of a job.

    :param key: of the job.
    :param fingerprint: of the job.
    :param value: what the work gave; None when it failed.
    :param error: why it failed, one line; empty when it did not.
    :param wall_s: how long it took, s.
    """

    key: str
    fingerprint: str = ''
    value: Optional[Value] = None
    error: str = ''
    wall_s: float = 0.0


@lru_cache(maxsize=1)
def source_hash(root: Path = Path(__file__).resolve().parents[2]) -> str:
    """Return a hash of the version and of the sources: results of other code are not ours."""
    digest = hashlib.sha256(__version__.encode())
    for path in sorted(root.rglob('*.py')):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def run_jobs(jobs: Sequence[Job], work: Work, *, out_dir: Union[str, Path, None],
             workers: int, description: str) -> list[Result]:
    """
    Run the jobs that are not done yet and return the results of all, in the order of the jobs.

    A job that raises, or whose process dies, gives a result with its reason; a later run tries
    it again.

    :param jobs: the jobs.
    :param work: a function of a module: a process of its own imports it.
    :param out_dir: folder that keeps ``runs.jsonl``; None keeps nothing.
    :param workers: number of processes; 0 runs the jobs in this one.
    :param description: label of the progress bar.
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
        missing = [job for job in jobs if job.key not in done]
        with tqdm(total=len(jobs), initial=len(done), desc=description, unit='run',
                  disable=None, smoothing=0.1) as bar:
            for result in spread(missing, work, workers) if workers > 0 else (
                    _attempt(job, work) for job in missing):
                # Set here: the sources may have changed since, and processes read them anew.
                result = replace(result, fingerprint=prints[result.key])
                done[result.key] = result
                journal.append(asdict(result))
                bar.update()
    return [done[key] for key in keys]


def failures(results: Sequence[Result]) -> list[str]:
    """Return a line for each job that failed, with its reason."""
    return [f'{result.key}: {result.error}' for result in results if result.error]


def _attempt(job: Job, work: Work) -> Result:
    """Run one job; whatever it raises becomes its reason."""
    start = time.perf_counter()
    try:
        # As it will be read back, so that a resumed run is the same.
        value, error = json.loads(json.dumps(work(job.parameters))), ''
    except StereoSpeedError as fault:
        value, error = None, str(fault)
    except Exception as fault:  # one job must not end the others, whatever its fault
        place = traceback.extract_tb(fault.__traceback__)[-1]
        error = f'{type(fault).__name__}: {fault} ({Path(place.filename).name}:{place.lineno})'
        value, error = None, ' '.join(error.split())
    return Result(key=job.key, value=value, error=error,
                  wall_s=round(time.perf_counter() - start, 3))


def _serve(pipe: Connection[Any, Any], work: Work) -> None:
    """Run in a process of its own: jobs come in, results go out, until None comes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends the run
    cv2.setNumThreads(1)  # the jobs fill the cores
    try:
        while (job := pipe.recv()) is not None:
            pipe.send(_attempt(job, work))
    except (EOFError, OSError):  # the parent is gone
        pass


class Worker:
    """
    A process, and the jobs that wait for it.

    :param work: what it does with a job.
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
        except OSError:  # it died idle; take() finds out
            pass

    def take(self) -> tuple[Result, bool]:
        """Receive the result of the job in hand, and whether the process is still there."""
        job, self.job = self.job, None
        assert job is not None
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
    Run the jobs in processes, and yield the results as they come.

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
    """Give a worker its next job: of its own group, of a new one, or half of another's."""
    if not worker.waiting and queue:
        worker.waiting = queue.popleft()
    if not worker.waiting:
        longest = max((other.waiting for other in pool), key=len)
        for _ in range((len(longest) + 1) // 2):
            worker.waiting.appendleft(longest.pop())
    if worker.waiting:
        worker.give(worker.waiting.popleft())
