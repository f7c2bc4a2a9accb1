# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A job of a batch, its execution and its result, common to all kinds of workers."""
from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
import hashlib
import json
from pathlib import Path
import time
import traceback
from typing import Any, Callable, Mapping, Optional, Sequence

from .. import __version__
from ..core.errors import StereoSpeedError

Value = Mapping[str, Any]
Work = Callable[[Value], Value]


@dataclass(frozen=True, kw_only=True)
class Job:
    """
    One job.

    :param key: name of the job, unique within a run.
    :param parameters: JSON values for the work; everything that the job depends on.
    :param group: jobs of one group run in one process if possible; by default each has its own.
    """

    key: str
    parameters: Value
    group: str = ''

    @property
    def fingerprint(self) -> str:
        """Return a hash of the parameters and of this package, which determine the result."""
        text = json.dumps([self.parameters, source_hash()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True, kw_only=True)
class Result:
    """
    The result of a job.

    :param key: key of the job.
    :param fingerprint: fingerprint of the job.
    :param value: value returned by the work; None when it failed.
    :param error: reason of the failure, one line; empty when it succeeded.
    :param wall_s: run time, s.
    :param refused: whether it failed because of its input.
    """

    key: str
    fingerprint: str = ''
    value: Optional[Value] = None
    error: str = ''
    wall_s: float = 0.0
    refused: bool = False


@lru_cache(maxsize=1)
def source_hash(root: Path = Path(__file__).resolve().parents[1]) -> str:
    """Return a hash of version and sources, so that results of other code are not reused."""
    digest = hashlib.sha256(__version__.encode())
    for path in sorted(root.rglob('*.py')):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def attempt(job: Job, work: Work) -> Result:
    """
    Run one job; an exception becomes the error of its result.

    :param job: the job.
    :param work: the function to run.
    """
    start, refused = time.perf_counter(), False
    try:
        # In the form in which it is read back, so that a resumed run is the same.
        value, error = json.loads(json.dumps(work(job.parameters))), ''
    except StereoSpeedError as fault:
        value, error, refused = None, str(fault), True
    except Exception as fault:  # no failure of a job may end the others
        place = traceback.extract_tb(fault.__traceback__)[-1]
        error = f'{type(fault).__name__}: {fault} ({Path(place.filename).name}:{place.lineno})'
        value, error = None, ' '.join(error.split())
    return Result(key=job.key, value=value, error=error, refused=refused,
                  wall_s=round(time.perf_counter() - start, 3))


def failures(results: Sequence[Result]) -> list[str]:
    """Return a line for each job that failed, with its reason."""
    return [f'{result.key}: {result.error}' for result in results if result.error]
