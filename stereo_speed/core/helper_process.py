# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A process that works for this one: asked through a pipe, given images in shared memory.

It is a process of its own, not a fork: what runs here has threads of others, which a fork lacks.
"""
from __future__ import annotations

from mmap import mmap
from multiprocessing.connection import Connection
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from typing import Any, Optional

from .threads import one_blas_thread

_START_S = 30.0  # that it may take to start: a second, on a machine that is not busy
_END_S = 2.0  # to end by itself


def leave_ending_to_parent() -> None:
    """Ignore signals that go to all of a group: the parent ends its helper, or ends."""
    for one in (signal.SIGINT, signal.SIGTERM):
        signal.signal(one, signal.SIG_IGN)


class HelperProcess:
    """
    The process; it ends with the one that started it.

    It takes a second until it is ready.

    :param module: that it runs, with the descriptors of its pipe and of the shared memory as
        arguments; it says that it is ready, and then answers.
    :param answer_s: that an answer may take.
    :param patience: with the processor, from its very start; 19 is the most there is.
    :raises OSError: no memory, no more processes, no such patience.
    """

    def __init__(self, module: str, answer_s: float, patience: int = 0) -> None:
        self._answer_s = answer_s
        one_blas_thread()
        ours, theirs = socket.socketpair()
        self._memory_fd = os.memfd_create('stereo_speed')
        environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))}
        # What is large is sent in several turns, and one that stands still takes two at most.
        turn = struct.pack('ll', *divmod(int(answer_s * 5e5), 10**6))
        for side in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
            ours.setsockopt(socket.SOL_SOCKET, side, turn)
        try:
            with theirs:
                self.process = subprocess.Popen(
                    [sys.executable, '-m', module, str(theirs.fileno()), str(self._memory_fd)],
                    stdin=subprocess.DEVNULL, pass_fds=(theirs.fileno(), self._memory_fd),
                    env=environment)
        except OSError:
            ours.close()
            os.close(self._memory_fd)
            raise
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
        self._pipe.close()
        try:
            self.process.wait(most_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        memory_fd, self._memory_fd = self._memory_fd, -1
        if memory_fd >= 0:
            os.close(memory_fd)
