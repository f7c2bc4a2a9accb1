# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Run independent jobs over the cores, once each: resumable, and deaf to the failure of one.

Each worker process takes whole groups of jobs, so that what the jobs of a group share (a rendered
sequence) is made once. Every finished job is a line of ``runs.jsonl``; a job whose line is there
with the same parameters and the same version of this package is not run again.
"""
from __future__ import annotations

from collections import deque
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
import hashlib
import json
from multiprocessing import connection, get_context
import os
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

Value = Mapping[str, Any]
Worker = Callable[[Value], Value]
_THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')
_JOIN_S = 5.0


@dataclass(frozen=True, kw_only=True)
class Job:
    """
    One job.

    :param key: names it, once among the jobs of a run.
    :param parameters: what the worker gets; JSON values only, with all the job depends on.
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
    :param value: what the worker gave; None when it failed.
    :param error: why it failed, one line; empty when it did not.
    :param wall_s: how long it took, s.
    """

    key: str
    fingerprint: str = ''
    value: Optional[Value] = None
    error: str = ''
    wall_s: float = 0.0


@lru_cache(maxsize=1)
def source_hash() -> str:
    """Return a hash of the version and of the sources: results of other code are not ours."""
    root, digest = Path(__file__).resolve().parents[2], hashlib.sha256(__version__.encode())
    for path in sorted(root.rglob('*.py')):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def run_jobs(jobs: Sequence[Job], worker: Worker, *, out_dir: Union[str, Path, None],
             workers: int, description: str) -> list[Result]:
    """
    Run the jobs that are not done yet and give the results of all, in the order of the jobs.

    A job that raises, or whose process dies, gives a result with its reason; a later run tries
    it again.

    :param jobs: the jobs.
    :param worker: a function of a module: a process of its own imports it.
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
            for result in _here(missing, worker) if workers < 1 else _spread(
                    missing, worker, workers):
                # Told here: the sources may have changed since, and processes read them anew.
                result = replace(result, fingerprint=prints[result.key])
                done[result.key] = result
                journal.append(asdict(result))
                bar.update()
    return [done[key] for key in keys]


def failures(results: Sequence[Result]) -> list[str]:
    """List the jobs that failed, each with its reason."""
    return [f'{result.key}: {result.error}' for result in results if result.error]


def _attempt(job: Job, worker: Worker) -> Result:
    """Run one job; whatever it raises becomes its reason."""
    start = time.perf_counter()
    try:
        # As it will be read back, so that a resumed run is the same.
        value, error = json.loads(json.dumps(worker(job.parameters))), ''
    except StereoSpeedError as fault:
        value, error = None, str(fault)
    except Exception as fault:  # one job must not end the others, whatever its fault
        place = traceback.extract_tb(fault.__traceback__)[-1]
        error = f'{type(fault).__name__}: {fault} ({Path(place.filename).name}:{place.lineno})'
        value, error = None, ' '.join(error.split())
    return Result(key=job.key, value=value, error=error,
                  wall_s=round(time.perf_counter() - start, 3))


def _here(jobs: Sequence[Job], worker: Worker) -> Iterator[Result]:
    """Run the jobs in this process."""
    for job in jobs:
        yield _attempt(job, worker)


def _serve(pipe: Any, worker: Worker) -> None:
    """Run in a process of its own: jobs come in, results go out, until None comes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends the run
    cv2.setNumThreads(1)  # the jobs fill the cores
    try:
        while (job := pipe.recv()) is not None:
            pipe.send(_attempt(job, worker))
    except (EOFError, OSError):  # the parent is gone
        pass


class _Seat:
    """A worker process, and the jobs that wait for it."""

    def __init__(self, worker: Worker) -> None:
        context = get_context('spawn')
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, worker), daemon=True)
        with _one_thread():
            self.process.start()
        theirs.close()
        self.waiting: deque[Job] = deque()
        self.job: Optional[Job] = None

    def give(self, job: Job) -> None:
        """Send a job."""
        self.job = job
        try:
            self.pipe.send(job)
        except OSError:  # it died idle; take() tells
            pass

    def take(self) -> tuple[Result, bool]:
        """Receive the result of the job in hand, and whether the process is still there."""
        job, self.job = self.job, None
        assert job is not None
        try:
            return self.pipe.recv(), True
        except (EOFError, OSError):
            self.process.join(_JOIN_S)
            return Result(key=job.key, error=(
                f'its process ended with status {self.process.exitcode}')), False

    def stop(self) -> None:
        """End the process at once."""
        self.process.terminate()
        self.process.join(_JOIN_S)
        self.pipe.close()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Have processes started meanwhile use one thread each in their linear algebra."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, '1'))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _spread(jobs: Sequence[Job], worker: Worker, workers: int) -> Iterator[Result]:
    """Run the jobs in processes, and give the results as they come."""
    groups: dict[str, deque[Job]] = {}
    for job in jobs:
        groups.setdefault(job.group or job.key, deque()).append(job)
    queue = deque(groups.values())
    seats = [_Seat(worker) for _ in range(min(workers, len(jobs)))]
    try:
        for seat in seats:
            _next(seat, queue, seats)
        while busy := [seat for seat in seats if seat.job is not None]:
            ready = connection.wait([seat.pipe for seat in busy])
            for seat in (seat for seat in busy if seat.pipe in ready):
                result, alive = seat.take()
                if not alive:
                    fresh = _Seat(worker)
                    fresh.waiting = seat.waiting
                    seats[seats.index(seat)] = fresh
                    seat.stop()
                    seat = fresh
                yield result
                _next(seat, queue, seats)
    finally:
        for seat in seats:
            seat.stop()


def _next(seat: _Seat, queue: deque[deque[Job]], seats: Sequence[_Seat]) -> None:
    """Give a process its next job: of its own group, of a new one, or half of another's."""
    if not seat.waiting and queue:
        seat.waiting = queue.popleft()
    if not seat.waiting:
        longest = max((other.waiting for other in seats), key=len)
        for _ in range((len(longest) + 1) // 2):
            seat.waiting.appendleft(longest.pop())
    if seat.waiting:
        seat.give(seat.waiting.popleft())
