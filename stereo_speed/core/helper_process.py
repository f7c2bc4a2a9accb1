# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A process that works for this one: asked through a pipe, given images in shared memory.

It is a fork of this one where this one has a single thread and its user wants that, which takes
a hundredth of a second; else a process of its own, whose imports take two: a fork lacks the
threads of the one that it is made of, and waits for ever for what they held.
"""
from __future__ import annotations

from contextlib import contextmanager
from importlib import import_module
from mmap import mmap
from multiprocessing.connection import Connection
import os
from pathlib import Path
import signal
import socket
import struct
import subprocess
import sys
import time
import traceback
from typing import Any, Callable, Iterable, Iterator, Optional, Union

from .threads import one_blas_thread

_START_S = 30.0  # that it may take to start: two, on a machine that is not busy
_END_S = 2.0  # to end by itself
_POLL_S = 0.005  # between two looks whether a fork has ended
_LONGEST_NAME = 15  # of a process, as the system keeps it


_ENDS = (signal.SIGINT, signal.SIGTERM)


def leave_ending_to_parent() -> None:
    """Ignore signals that go to all of a group: the parent ends its helper, or ends."""
    for one in _ENDS:
        signal.signal(one, signal.SIG_IGN)


@contextmanager
def _ends_held_back() -> Iterator[None]:
    """Start processes that are not sent such signals before they ignore them."""
    former = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def can_fork() -> bool:
    """Return whether a fork lacks nothing that this process has: it has no other thread."""
    try:
        return len(os.listdir('/proc/self/task')) == 1
    except OSError:  # there is no telling
        return False


class Fork:
    """
    A fork of this process; it has what is asked of a ``subprocess.Popen`` here.

    :param work: done by the fork, which ends after it, without what this process has to do then.
    :raises OSError: no memory, no more processes.
    """

    def __init__(self, work: Callable[[], object]) -> None:
        for stream in (sys.stdout, sys.stderr):  # or both would write what it holds
            stream.flush()
        self.returncode: Optional[int] = None
        self.pid = os.fork()
        if self.pid == 0:
            status = 1
            try:
                work()
                status = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(status)

    def poll(self) -> Optional[int]:
        """Return how it has ended, below 0 by which signal; None where it has not."""
        if self.returncode is None:
            try:
                pid, status = os.waitpid(self.pid, os.WNOHANG)
            except ChildProcessError:  # signals of ends are ignored here, so nobody knows how
                pid, status = self.pid, 0
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: Optional[float] = None) -> int:
        """
        Wait until it has ended; return how.

        :param timeout: s, at most.
        :raises subprocess.TimeoutExpired: it has not.
        """
        until_s = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if until_s is not None and time.monotonic() >= until_s:
                raise subprocess.TimeoutExpired('fork', timeout or 0.0)
            time.sleep(_POLL_S)
        return code

    def kill(self) -> None:
        """End it, if it has not ended."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)


class HelperProcess:
    """
    The process; it ends with the one that started it.

    :param module: that it runs: its ``main`` with the descriptors of its pipe and of the shared
        memory; it says that it is ready, and then answers.
    :param answer_s: that an answer may take.
    :param patience: with the processor, from its very start; 19 is the most there is.
    :param fork: whether it is to be a fork of this process, where :func:`can_fork`; else it takes
        two seconds until it is ready.
    :raises OSError: no memory, no more processes, no such patience.
    """

    _pipes: set[int] = set()  # descriptors of all pipes of this process to its helpers

    def __init__(self, module: str, answer_s: float, patience: int = 0, *, fork: bool = False
                 ) -> None:
        self._answer_s = answer_s
        one_blas_thread()
        ours, theirs = socket.socketpair()
        self._memory_fd = os.memfd_create('stereo_speed')
        # What is large is sent in several turns, and one that stands still takes two at most.
        turn = struct.pack('ll', *divmod(int(answer_s * 5e5), 10**6))
        for side in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
            ours.setsockopt(socket.SOL_SOCKET, side, turn)
        try:
            with theirs:
                start = _forked if fork and can_fork() else _started
                self.process: Union[Fork, subprocess.Popen[bytes]] = start(
                    module, theirs.fileno(), self._memory_fd, {*self._pipes, ours.fileno()})
        except OSError:
            ours.close()
            os.close(self._memory_fd)
            raise
        self._pipes.add(ours.fileno())
        self._pipe: Connection[Any, Any] = Connection(ours.detach())
        self._memory: Optional[mmap] = None
        try:
            if patience:  # now, for its imports take a second of one core
                os.setpriority(os.PRIO_PROCESS, self.process.pid,
                               os.getpriority(os.PRIO_PROCESS, 0) + patience)
        except OSError:
            self.close(0.0)
            raise

    def wait(self) -> None:
        """
        Wait until it is ready.

        :raises OSError: it has ended, or is not ready in time.
        """
        if not self._pipe.poll(_START_S):
            raise TimeoutError(f'not ready in {_START_S:g} s')
        self._received(0.0)

    def is_ready(self) -> bool:
        """
        Return whether it can be asked; to be called until then, in place of ``wait``.

        :raises OSError: it has ended.
        """
        if not self._pipe.poll(0.0):
            return False
        self._received(0.0)
        return True

    def has_answer(self) -> bool:
        """Return whether ``received`` would not wait: there is an answer, or it has ended."""
        return self._pipe.poll(0.0)

    def send(self, request: Any) -> None:
        """
        Send a request.

        :raises OSError: the process has ended, or does not take it in time.
        """
        try:
            self._pipe.send(request)
        except BlockingIOError:
            raise self._late() from None

    def answered(self, request: Any) -> Any:
        """
        Return the answer to a request; sending it counts as part of that.

        :raises OSError: the process has ended, or does not answer in time.
        """
        until_s = time.monotonic() + self._answer_s
        self.send(request)
        return self._received(max(until_s - time.monotonic(), 0.0))

    def memory(self, least_bytes: int) -> mmap:
        """Return the shared memory, of at least so many bytes; it only ever grows."""
        if self._memory is None or len(self._memory) < least_bytes:
            os.ftruncate(self._memory_fd, least_bytes)
            self._memory = mmap(self._memory_fd, least_bytes)
        return self._memory

    def received(self) -> Any:
        """
        Return the answer to the last request that has one.

        :raises OSError: the process has ended, or does not answer in time.
        """
        return self._received(self._answer_s)

    def _received(self, most_s: float) -> Any:
        if not self._pipe.poll(most_s):
            raise self._late()
        try:
            return self._pipe.recv()
        except EOFError:
            raise BrokenPipeError('it has ended') from None
        except BlockingIOError:  # it stands still in the middle
            raise self._late() from None

    def _late(self) -> TimeoutError:
        return TimeoutError(f'no answer in {self._answer_s:g} s')

    def close(self, most_s: float = _END_S) -> None:
        """
        End the process; once is enough.

        :param most_s: for which it may end by itself.
        """
        if not self._pipe.closed:
            self._pipes.discard(self._pipe.fileno())
        self._pipe.close()
        try:
            self.process.wait(most_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        memory_fd, self._memory_fd = self._memory_fd, -1
        if memory_fd >= 0:
            os.close(memory_fd)


def _started(module: str, pipe_fd: int, memory_fd: int, others: Iterable[int]
             ) -> subprocess.Popen[bytes]:
    """Return a new process that runs a module; it has no other descriptors of this one."""
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))}
    with _ends_held_back():
        return subprocess.Popen(
            [sys.executable, '-m', module, str(pipe_fd), str(memory_fd)], env=environment,
            stdin=subprocess.DEVNULL, pass_fds=(pipe_fd, memory_fd))


def _forked(module: str, pipe_fd: int, memory_fd: int, others: Iterable[int]) -> Fork:
    """
    Return a fork of this process that runs a module.

    :param others: descriptors that it closes: a pipe ends where all who have its end close it.
    """
    main = import_module(module).main

    def work() -> None:
        _name_process(module.rpartition('.')[2])
        for fd in others:
            os.close(fd)
        main(pipe_fd, memory_fd)
    with _ends_held_back():
        return Fork(work)


def _name_process(name: str) -> None:
    """Give this process a name of its own, for a fork has the command line of its parent."""
    try:
        Path('/proc/self/comm').write_text(name[:_LONGEST_NAME])
    except OSError:  # then it has none
        pass
