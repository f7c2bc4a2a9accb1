# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Helper processes that cannot be started."""
from __future__ import annotations

import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

import pytest
from stereo_speed.core import helper_process
from stereo_speed.core.helper_process import can_fork, HelperProcess

END_S = 20.0
FORKS = """
import sys
from stereo_speed.core.helper_process import Fork
from stereo_speed.detection.beside import SearchProcess
from stereo_speed.pipeline.pass_process import PassProcess
forks = [SearchProcess(fork=True), PassProcess(fork=True)]
for one in forks:
    one.wait()
    assert isinstance(one.process, Fork)
print(*(one.process.pid for one in forks), flush=True)
input()
forks[0].close(20.0)
print(forks[0].process.returncode, forks[1].process.poll(), flush=True)
forks[1].close(20.0)
print(forks[1].process.returncode, flush=True)
"""


def test_process_whose_priority_is_refused_is_ended_cleanly(monkeypatch):
    began = []

    def refuse(which, pid, priority):
        began.append(pid)
        raise PermissionError('no')
    monkeypatch.setattr(os, 'setpriority', refuse)
    opened = len(os.listdir('/proc/self/fd'))
    with pytest.raises(PermissionError, match='no'):
        HelperProcess('stereo_speed.detection.search_process', 5.0, patience=1)
    with pytest.raises(ChildProcessError):  # it has ended, and its status was taken
        os.waitpid(began[0], os.WNOHANG)
    assert len(os.listdir('/proc/self/fd')) == opened


@pytest.mark.parametrize('end', [signal.SIGINT, signal.SIGTERM])
def test_signal_to_the_group_does_not_end_a_process_just_started(end, capfd):
    """Its parent may still need it, and it must not end with a traceback."""
    former = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    helper = HelperProcess('stereo_speed.detection.search_process', 5.0)
    for _ in range(10):  # while it imports
        helper.process.send_signal(end)
        time.sleep(0.02)
    helper.wait()
    helper.close(END_S)
    assert helper.process.returncode == 0 and not capfd.readouterr().err
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == former  # this process is sent them


@pytest.fixture()
def forking():
    """Return a single-threaded process with two forks, which is ended afterwards."""
    process = subprocess.Popen([sys.executable, '-c', FORKS], stdin=subprocess.PIPE,
                               stdout=subprocess.PIPE, text=True)
    with process:
        try:
            yield process
        finally:
            process.kill()


def test_fork_ends_when_it_is_closed_while_another_continues(forking):
    forking.stdout.readline()
    said, _ = forking.communicate('\n', END_S)
    assert said.splitlines() == ['0 None', '0']


def test_forks_end_with_their_parent(forking):
    pids = forking.stdout.readline().split()
    forking.kill()
    until_s = time.monotonic() + END_S
    while any(is_running(pid) for pid in pids) and time.monotonic() < until_s:
        time.sleep(0.01)
    assert len(pids) == 2 and not any(is_running(pid) for pid in pids)


def is_running(pid):
    """Return whether a process exists and has not ended."""
    try:
        return Path('/proc', pid, 'stat').read_text().rsplit(')', 1)[1].split()[0] != 'Z'
    except FileNotFoundError:
        return False


FAILS = """
import sys
from stereo_speed.core.helper_process import Fork
fork = Fork(lambda: sys.exit(0))
assert fork.wait(20.0) == 1 == fork.poll()
fork.kill()  # which does nothing any more
"""
COLLECTS = """
import gc, os
from stereo_speed.core.helper_process import Fork
gc.disable()
fork = Fork(lambda: gc.isenabled() or os._exit(3))
assert not gc.isenabled() and fork.wait(20.0) == 0
"""
WAITED_FOR = """
import subprocess, time
from stereo_speed.core.helper_process import Fork
fork = Fork(lambda: time.sleep(20.0))
try:
    fork.wait(0.0)
except subprocess.TimeoutExpired:
    pass
else:
    raise AssertionError('it has not ended')
assert fork.poll() is None
fork.kill()
assert fork.wait(20.0) == -9
"""
UNKNOWN = """
import os
from stereo_speed.core.helper_process import Fork
fork = Fork(lambda: None)
os.waitpid(fork.pid, 0)  # as where signals of ends are ignored
assert fork.wait(20.0) == 0
"""


def run_alone(program):
    """Run a program in a process with one thread; return what it and its forks report."""
    done = subprocess.run([sys.executable, '-W', 'error', '-c', program], timeout=2 * END_S,
                          text=True, capture_output=True)
    assert done.returncode == 0, done.stderr
    return done.stderr


def test_exception_in_a_fork_is_its_exit_status_only():
    assert 'SystemExit' in run_alone(FAILS)


@pytest.mark.parametrize('program', [COLLECTS, WAITED_FOR, UNKNOWN], ids=[
    'a fork collects garbage although its parent has paused that',
    'a running fork is waited for up to the limit and can be killed',
    'an unknown exit status counts as success'])
def test_fork(program):
    assert run_alone(program) == ''


def test_separate_process_is_started_where_forking_is_impossible(monkeypatch):
    def start(*_):
        raise OSError('started')
    monkeypatch.setattr(helper_process, 'can_fork', lambda: False)
    monkeypatch.setattr(helper_process, '_started', start)
    with pytest.raises(OSError, match='started'):
        HelperProcess('stereo_speed.detection.search_process', 5.0, fork=True)


def test_process_with_other_threads_is_not_forked():
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    try:
        assert not can_fork()
    finally:
        done.set()
        thread.join()
