# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A helper process that takes requests through a pipe and images through shared memory.

It is a fork if the caller asks for one and this process has a single thread; that takes a
hundredth of a second.  Otherwise it is a new process, whose imports take two seconds: a fork
lacks the other threads of its parent and would wait for ever for locks that they held.
"""
from __future__ import annotations

from contextlib import contextmanager
import gc
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

_START_S = 30.0  # time limit of a start, which takes two seconds on an idle machine
_END_S = 2.0  # time that a helper has to end by itself
_POLL_S = 0.005  # interval of the checks whether a fork has ended
_LONGEST_NAME = 15  # characters of a process's name, to which the kernel truncates it
_END_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def leave_ending_to_parent() -> None:
    """Ignore signals sent to the whole process group; the parent ends its helper."""
    for number in _END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def _end_signals_blocked() -> Iterator[None]:
    """Block the signals to end, also in processes started meanwhile, which ignore them later."""
    former = signal.pthread_sigmask(signal.SIG_BLOCK, _END_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def can_fork() -> bool:
    """Return whether this process can be forked safely: it has no other thread."""
    try:
        return len(os.listdir('/proc/self/task')) == 1
    except OSError:  # number of threads unknown
        return False


class Fork:
    """
    A fork of this process, with the part of the interface of ``subprocess.Popen`` used here.

    :param work: run by the fork, which then exits without running the exit handlers of this
        process.
    :raises OSError: no memory, or no more processes.
    """

    def __init__(self, work: Callable[[], object]) -> None:
        for stream in (sys.stdout, sys.stderr):  # or both processes would write their buffers
            stream.flush()
        self.returncode: Optional[int] = None
        self.pid = os.fork()
        if self.pid == 0:
            status = 1
            try:
                gc.enable()  # the parent may have paused it while it imports
                work()
                status = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(status)

    def poll(self) -> Optional[int]:
        """Return the exit code, negative for a signal; None while it runs."""
        if self.returncode is None:
            try:
                pid, status = os.waitpid(self.pid, os.WNOHANG)
            except ChildProcessError:  # SIGCHLD is ignored here, so the exit code is unknown
                pid, status = self.pid, 0
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: Optional[float] = None) -> int:
        """
        Wait until it has ended, and return its exit code.

        :param timeout: time limit, s; None for none.
        :raises subprocess.TimeoutExpired: it has not ended in time.
        """
        until_s = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if until_s is not None and time.monotonic() >= until_s:
                raise subprocess.TimeoutExpired('fork', timeout or 0.0)
            time.sleep(_POLL_S)
        return code

    def kill(self) -> None:
        """Kill the process if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)


class HelperProcess:
    """
    A helper process; it ends when the process that started it ends.

    :param module: name of the module that it runs.  Its ``main`` gets the descriptors of the pipe
        and of the shared memory, sends a message when it is ready, and then answers requests.
    :param answer_s: time limit of an answer, s.
    :param patience: niceness relative to this process, from its start on; 19 at most.
    :param fork: whether to fork this process if :func:`can_fork`; a new process takes two seconds
        to be ready.
    :raises OSError: no memory, no more processes, or the niceness cannot be set.
    """

    _pipes: set[int] = set()  # descriptors of all pipes from this process to its helpers

    def __init__(self, module: str, answer_s: float, patience: int = 0, *, fork: bool = False
                 ) -> None:
        self._answer_s = answer_s
        one_blas_thread()
        ours, theirs = socket.socketpair()
        self._memory_fd = os.memfd_create('stereo_speed')
        # A large message takes several system calls; a stalled one at most two such timeouts.
        timeout = struct.pack('ll', *divmod(int(answer_s * 5e5), 10**6))
        for side in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
            ours.setsockopt(socket.SOL_SOCKET, side, timeout)
        try:
            with theirs:
                fds = theirs.fileno(), self._memory_fd
                self.process: Union[Fork, subprocess.Popen[bytes]] = (
                    _forked(module, *fds, {*self._pipes, ours.fileno()})
                    if fork and can_fork() else _started(module, *fds))
        except OSError:
            ours.close()
            os.close(self._memory_fd)
            raise
        self._pipes.add(ours.fileno())
        self._pipe: Connection[Any, Any] = Connection(ours.detach())
        self._memory: Optional[mmap] = None
        try:
            if patience:  # set now, as the imports take a second of one core
                os.setpriority(os.PRIO_PROCESS, self.process.pid,
                               os.getpriority(os.PRIO_PROCESS, 0) + patience)
        except OSError:
            self.close(0.0)
            raise

    def wait(self) -> None:
        """
        Wait until the helper is ready.

        :raises OSError: it has ended, or is not ready in time.
        """
        if not self._pipe.poll(_START_S):
            raise TimeoutError(f'not ready in {_START_S:g} s')
        self._received(0.0)

    def is_ready(self) -> bool:
        """
        Return whether the helper is ready; poll it in place of ``wait``, and not after True.

        :raises OSError: it has ended.
        """
        if not self._pipe.poll(0.0):
            return False
        self._received(0.0)
        return True

    def has_answer(self) -> bool:
        """Return whether ``received`` would return at once: with an answer or an error."""
        return self._pipe.poll(0.0)

    def send(self, request: Any) -> None:
        """
        Send a request.

        :raises OSError: the process has ended, or does not accept the request in time.
        """
        try:
            self._pipe.send(request)
        except BlockingIOError:
            raise self._timeout_error() from None

    def answered(self, request: Any) -> Any:
        """
        Send a request and return its answer; the time limit includes the sending.

        :raises OSError: the process has ended, or does not answer in time.
        """
        until_s = time.monotonic() + self._answer_s
        self.send(request)
        return self._received(max(until_s - time.monotonic(), 0.0))

    def memory(self, least_bytes: int) -> mmap:
        """Return the shared memory, grown to at least so many bytes; it never shrinks."""
        if self._memory is None or len(self._memory) < least_bytes:
            os.ftruncate(self._memory_fd, least_bytes)
            self._memory = mmap(self._memory_fd, least_bytes)
        return self._memory

    def received(self) -> Any:
        """
        Wait for the next answer and return it.

        :raises OSError: the process has ended, or does not answer in time.
        """
        return self._received(self._answer_s)

    def _received(self, most_s: float) -> Any:
        if not self._pipe.poll(most_s):
            raise self._timeout_error()
        try:
            return self._pipe.recv()
        except EOFError:
            raise BrokenPipeError('it has ended') from None
        except BlockingIOError:  # the answer stalled halfway
            raise self._timeout_error() from None

    def _timeout_error(self) -> TimeoutError:
        return TimeoutError(f'no answer in {self._answer_s:g} s')

    def close(self, most_s: float = _END_S) -> None:
        """
        End the process; further calls have no effect.

        :param most_s: time that it has to end by itself before it is killed, s.
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


def _started(module: str, pipe_fd: int, memory_fd: int) -> subprocess.Popen[bytes]:
    """Return a new process that runs a module; it inherits no other descriptors."""
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))}
    with _end_signals_blocked():
        return subprocess.Popen(
            [sys.executable, '-m', module, str(pipe_fd), str(memory_fd)], env=environment,
            stdin=subprocess.DEVNULL, pass_fds=(pipe_fd, memory_fd))


def _forked(module: str, pipe_fd: int, memory_fd: int, others: Iterable[int]) -> Fork:
    """
    Return a fork of this process that runs a module.

    :param others: descriptors that it closes, because a pipe ends only when all of its holders
        have closed it.
    """
    main = import_module(module).main

    def work() -> None:
        _name_process(module.rpartition('.')[2])
        for fd in others:
            os.close(fd)
        main(pipe_fd, memory_fd)
    with _end_signals_blocked():
        return Fork(work)


def _name_process(name: str) -> None:
    """Name this process, because a fork has the command line of its parent."""
    try:
        Path('/proc/self/comm').write_text(name[:_LONGEST_NAME])
    except OSError:  # the name only helps to tell processes apart
        pass
