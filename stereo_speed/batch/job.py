# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A job of a batch, the attempt at it, and what came of it; every kind of worker speaks these."""
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
    :param refused: whether it failed by its input, told in a line that says what was wanted.
    """

    key: str
    fingerprint: str = ''
    value: Optional[Value] = None
    error: str = ''
    wall_s: float = 0.0
    refused: bool = False


@lru_cache(maxsize=1)
def source_hash(root: Path = Path(__file__).resolve().parents[1]) -> str:
    """Return a hash of the version and of the sources: results of other code are not ours."""
    digest = hashlib.sha256(__version__.encode())
    for path in sorted(root.rglob('*.py')):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def attempt(job: Job, work: Work) -> Result:
    """
    Run one job; whatever it raises becomes its reason.

    :param job: the job.
    :param work: what to do with it.
    """
    start, refused = time.perf_counter(), False
    try:
        # As it will be read back, so that a resumed run is the same.
        value, error = json.loads(json.dumps(work(job.parameters))), ''
    except StereoSpeedError as fault:
        value, error, refused = None, str(fault), True
    except Exception as fault:  # one job must not end the others, whatever its fault
        place = traceback.extract_tb(fault.__traceback__)[-1]
        error = f'{type(fault).__name__}: {fault} ({Path(place.filename).name}:{place.lineno})'
        value, error = None, ' '.join(error.split())
    return Result(key=job.key, value=value, error=error, refused=refused,
                  wall_s=round(time.perf_counter() - start, 3))


def failures(results: Sequence[Result]) -> list[str]:
    """Return a line for each job that failed, with its reason."""
    return [f'{result.key}: {result.error}' for result in results if result.error]
