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
import socket
import subprocess
import sys
from typing import Any, Optional

from .threads import one_blas_thread

_START_S = 30.0  # that it may take to start: a second, on a machine that is not busy
_END_S = 2.0  # to end by itself


class HelperProcess:
    """
    The process; it ends with the one that started it.

    It takes a second until it is ready.

    :param module: that it runs, with the descriptors of its pipe and of the shared memory as
        arguments; it says that it is ready, and then answers.
    :param answer_s: that an answer may take.
    """

    def __init__(self, module: str, answer_s: float) -> None:
        self._answer_s = answer_s
        one_blas_thread()
        ours, theirs = socket.socketpair()
        self._memory_fd = os.memfd_create('stereo_speed')
        environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))}
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, '-m', module, str(theirs.fileno()), str(self._memory_fd)],
                stdin=subprocess.DEVNULL, pass_fds=(theirs.fileno(), self._memory_fd),
                env=environment)
        self._pipe: Connection[Any, Any] = Connection(ours.detach())
        self._memory: Optional[mmap] = None

    def wait(self) -> None:
        """
        Wait until it is ready.

        :raises OSError: it has ended, or is not ready in time.
        """
        self._received(_START_S)

    def send(self, request: Any) -> None:
        """
        Send a request.

        :raises OSError: the process has ended.
        """
        self._pipe.send(request)

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
            raise TimeoutError(f'no answer in {most_s:g} s')
        try:
            return self._pipe.recv()
        except EOFError:
            raise BrokenPipeError('it has ended') from None

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        try:
            self.process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        if self._memory_fd >= 0:
            os.close(self._memory_fd)
            self._memory_fd = -1
