# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The verdict on a reader of damaged input: refused in one line, accepted, or at fault.

It is at fault if it raises anything but an error of this package, warns, writes to standard error,
or exceeds bounds of time and memory.
"""
from __future__ import annotations

from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
import io
import json
import os
from pathlib import Path
import signal
import traceback
from types import FrameType
from typing import Callable, Iterator, Optional
import warnings

from ...core.errors import StereoSpeedError

MOST_S = 20.0  # time limit of a case; a whole measurement takes a second or two
MOST_MB = 700  # memory limit of a case: the largest accepted image, and the reader's copies


@dataclass(frozen=True)
class Outcome:
    """
    The outcome of one case.

    :param subject: the fuzzed reader.
    :param refused: whether the input was refused in one line.
    :param fault: description of wrong behaviour; empty when there is none.
    """

    subject: str
    refused: bool
    fault: str = ''


class _TooLongError(BaseException):
    """A case takes too long; not an Exception, so that no reader catches it."""


def judge(subject: str, call: Callable[[], object], folder: Path) -> Outcome:
    """
    Run a reader and judge its behaviour.

    :param subject: its name.
    :param call: the call, which may raise anything; a command returns its exit status.
    :param folder: folder for the file ``err``, which captures standard error.
    """
    fault, refused = '', False
    before_mb = _reset_peak()
    with _stderr_in(folder / 'err'), _within(MOST_S):
        try:
            with redirect_stdout(io.StringIO()), warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter('always', RuntimeWarning)
                status = call()
            fault = ''.join(f'warned: {w.message} ({Path(w.filename).name}:{w.lineno})'
                            for w in warned if issubclass(w.category, RuntimeWarning))
            refused = isinstance(status, int) and status == 2
            if isinstance(status, str):
                fault = status
        except StereoSpeedError as error:
            refused = True
            if not str(error).strip() or '\n' in str(error):
                fault = f'not one line: {str(error)!r}'
        except OSError as error:  # the command line turns it into one line
            refused, fault = True, '' if error.strerror else f'{error!r}'
        except _TooLongError:
            fault = f'took more than {MOST_S:g} s'
        except BaseException as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            fault = f'{type(error).__name__}: {str(error)[:200]} ' \
                    f'({Path(place.filename).name}:{place.lineno})'
    written = (folder / 'err').read_text(errors='replace')
    if not fault and written:
        fault = _fault_of_stderr(written, refused)
    grown_mb = _status_mb('VmHWM') - before_mb
    if not fault and grown_mb > MOST_MB:
        fault = f'used {grown_mb:.0f} MB'
    return Outcome(subject, refused, ' '.join(fault.split()))


@contextmanager
def _stderr_in(path: Path) -> Iterator[None]:
    """Redirect standard error, also of C libraries, to a file."""
    saved = os.dup(2)
    with path.open('w', buffering=1) as file:
        os.dup2(file.fileno(), 2)
        try:
            with redirect_stderr(file):
                yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)


@contextmanager
def _within(seconds: float) -> Iterator[None]:
    """Raise if a block takes too long."""
    def stop(number: int, frame: Optional[FrameType]) -> None:
        raise _TooLongError
    before = signal.signal(signal.SIGALRM, stop)
    signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, 6 * seconds)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGALRM, before)


def _fault_of_stderr(written: str, refused: bool) -> str:
    """Return what is wrong with the output on standard error; empty where it is allowed."""
    lines = written.splitlines()
    if refused and len(lines) == 1 and lines[0].startswith('error: ') and written.endswith('\n'):
        return ''
    warned = [line for line in lines if not line.startswith('warning: ')]
    return f'wrote to standard error: {json.dumps(written[:400])}' if refused or warned else ''


def _reset_peak() -> float:
    """Reset the peak of memory, and return the memory in use, MB."""
    try:
        Path('/proc/self/clear_refs').write_text('5')
    except OSError:
        pass
    return _status_mb('VmRSS')


def _status_mb(key: str) -> float:
    for line in Path('/proc/self/status').read_text().splitlines():
        if line.startswith(key + ':'):
            return int(line.split()[1]) / 1024
    return 0.0
