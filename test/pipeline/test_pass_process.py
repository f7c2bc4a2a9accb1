# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Passes measured in a separate process: same results, and survival of its death."""
from __future__ import annotations

from functools import partial
import operator
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from stereo_speed.io.bags import StereoBag
from stereo_speed.io.trace_json import trace_text
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.pipeline.conclusions import AtOnce, Beside, OnlyHereError
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.pipeline.pass_process import PassProcess, PassProcessError
from stereo_speed.pipeline.run import run
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init

END_S = 20.0
BEGIN = ('from stereo_speed.pipeline.pass_process import PassProcess\n'
         'p = PassProcess()\np.wait()\nprint(p.process.pid, flush=True)\ninput()')


@pytest.fixture(scope='module')
def ready():
    process = PassProcess(answer_s=120.0)  # a busy machine gives it little: its priority is low
    process.wait()
    yield process
    process.close()


def test_sample_measured_in_it_gives_the_same_result(sample, ready):
    with StereoBag(sample / 'bag') as bag:
        pairs, rig = list(bag.pairs()), bag.rig
    place = MeasuringSite.of(load_site(sample / 'site.yaml'), rig)
    beside = Beside(measured=ready.measured)
    one, other = (run(place.pipeline(PipelineConfig(), load_init(sample / 'init.yaml'),
                                     conclusions=way), pairs) for way in (AtOnce(), beside))
    beside.close()
    assert len(one.passes) == len(other.passes) == 1
    for field in ('speed_mps', 'speed_std_mps', 'smoothed', 'smoothed_std', 'budget', 'reason',
                  'verdict', 'vehicle', 'second', 'direction'):
        assert getattr(one.passes[0], field) == getattr(other.passes[0], field)
    assert trace_text('run', one.passes[0]) == trace_text('run', other.passes[0])


def test_arrays_of_all_sizes_arrive_unchanged(ready):
    """Large ones are in shared memory, which grows as needed."""
    rng = np.random.default_rng(0)
    for count in (10, 10**5, 3 * 10**6, 10**5):
        these = [rng.integers(0, 255, count + k, np.uint8) for k in range(3)]
        found = ready.measured(partial(np.concatenate, these))
        assert (found == np.concatenate(these)).all()


def test_measuring_error_is_raised_and_the_next_pass_is_measured(ready):
    with pytest.raises(ZeroDivisionError):
        ready.measured(partial(operator.truediv, 1, 0))
    assert ready.measured(partial(operator.add, 1, 2)) == 3


def test_unpicklable_pass_is_an_error(ready):
    with pytest.raises(OnlyHereError, match='cannot be pickled'):
        ready.measured(lambda: 'a')
    assert ready.measured(partial(operator.add, 1, 2)) == 3


def test_dead_process_is_reported():
    process = PassProcess()
    process.wait()
    process.process.kill()
    process.process.wait(END_S)
    with pytest.raises(PassProcessError):
        process.measured(partial(operator.add, 1, 2))
    process.close()


class OnlyThere:
    """Can be pickled, but not unpickled."""

    def __reduce__(self):
        return operator.truediv, (1, 0)


def test_pass_that_cannot_be_unpickled_is_an_error(ready):
    with pytest.raises(OnlyHereError, match='zero'):
        ready.measured(partial(str, OnlyThere()))
    assert ready.measured(partial(operator.add, 1, 2)) == 3


def test_signal_to_the_group_does_not_end_it_but_its_parents_end_does():
    with subprocess.Popen([sys.executable, '-c', BEGIN], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        ignored = next(line for line in Path(f'/proc/{pid}/status').read_text().splitlines()
                       if line.startswith('SigIgn'))
        for one in (signal.SIGINT, signal.SIGTERM):
            assert int(ignored.split()[1], 16) >> (one - 1) & 1
            os.kill(pid, one)
        assert Path(f'/proc/{pid}/cmdline').read_text()
        parent.kill()
    end_s = time.monotonic() + END_S
    while Path(f'/proc/{pid}/cmdline').exists() and Path(f'/proc/{pid}/cmdline').read_text():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def test_failed_start_leaves_nothing_open(monkeypatch):
    def fails(*args, **kwargs):
        raise OSError('no more processes')
    monkeypatch.setattr(subprocess, 'Popen', fails)
    before = len(os.listdir('/proc/self/fd'))
    with pytest.raises(OSError, match='no more processes'):
        PassProcess()
    assert len(os.listdir('/proc/self/fd')) <= before


@pytest.mark.parametrize('sent_bytes', [10, 4 * 10**6])
def test_unresponsive_process_is_waited_for_up_to_the_limit(sent_bytes):
    """Data larger than the pipe's buffer cannot even be sent."""
    process = PassProcess(answer_s=0.3)
    process.wait()
    try:
        os.kill(process.process.pid, signal.SIGSTOP)
        begun_s = time.monotonic()
        with pytest.raises(PassProcessError, match='no answer in 0.3 s'):
            process.measured(partial(len, 'a' * sent_bytes))
        assert time.monotonic() - begun_s > 0.29
        process.close(0.0)  # that stands still
    finally:
        process.process.kill()
        process.process.wait(END_S)
    assert process.process.returncode is not None
