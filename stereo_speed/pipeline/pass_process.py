# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The process that measures passes that are over, beside the pairs that follow.

Because of Python's global interpreter lock, a pass measured in a thread would delay the readings
of the other vehicles, however many cores there are.
"""
from __future__ import annotations

from mmap import MAP_PRIVATE, mmap
from multiprocessing.connection import Connection
import pickle
import sys
from typing import Any, Callable, Optional, Sequence, Union

import cv2
import numpy as np

from .conclusions import Measure, OnlyHereError
from ..core.compiled import warm_up
from ..core.helper_process import HelperProcess, leave_ending_to_parent
from ..core.passes import PassResult

_LEAST_BYTES = 1 << 16  # smaller buffers go through the pipe
_ALIGNED = 64  # bytes, the alignment of numpy arrays
_PATIENCE = 10  # niceness, so that readings come first


class PassProcessError(Exception):
    """The process is no longer usable: it has ended, or does not answer."""


class PassProcess(HelperProcess):
    """
    The process; see the module's docstring.

    :param answer_s: time-out of a pass, s; measuring one takes some tenths of a second.
    :param fork: as in :class:`HelperProcess`.
    """

    def __init__(self, answer_s: float = 10.0, *, fork: bool = False) -> None:
        super().__init__(
            'stereo_speed.pipeline.pass_process', answer_s, _PATIENCE, fork=fork)

    def measured(self, measure: Measure) -> PassResult:
        """
        Return the result of a pass.

        :param measure: measures the pass; it is pickled, with all that it holds.
        :raises PassProcessError: the process has failed.
        :raises OnlyHereError: the pass cannot be pickled; others may be.
        :raises Exception: the error that measuring the pass has raised.
        """
        try:
            answer = self._answer(measure)
        except OnlyHereError:
            raise
        except Exception as error:
            raise PassProcessError(str(error)) from error
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _answer(self, measure: Measure) -> Union[PassResult, Exception]:
        """Return the result of a pass, or the error that measuring it has raised."""
        images: list[memoryview] = []

        def inline(buffer: pickle.PickleBuffer) -> bool:
            raw = buffer.raw()
            if raw.nbytes >= _LEAST_BYTES:
                images.append(raw)
                return False
            return True
        try:
            text = pickle.dumps(measure, protocol=5, buffer_callback=inline)
        except Exception as error:  # a tracker of another package may raise anything
            raise OnlyHereError(f'the pass cannot be pickled: {error}') from error
        answer: Union[PassResult, Exception] = self.answered((self._shared(images), text))
        return answer

    def _shared(self, images: Sequence[memoryview]) -> list[tuple[int, int]]:
        """Copy images into the shared memory; return the first byte and the end of each."""
        places, end = [], 0
        for image in images:
            begin = -(-end // _ALIGNED) * _ALIGNED
            end = begin + image.nbytes
            places.append((begin, end))
        memory = np.frombuffer(self.memory(max(end, 1)), np.uint8)
        for image, (begin, end) in zip(images, places, strict=True):
            memory[begin:end] = np.frombuffer(image, np.uint8)
        return places


def measured_beside(process: Optional[PassProcess], measure: Measure,
                    failed: Callable[[PassProcess, str], object],
                    only_here: Callable[[str], object]) -> PassResult:
    """
    Return the result of a pass from a process, or measure it here where that fails.

    :param process: the process; None if there is none.
    :param measure: measures the pass.
    :param failed: called with a process that is no longer usable, and why.
    :param only_here: called with the reason why another process cannot measure this pass.
    """
    if process is not None:
        try:
            return process.measured(measure)
        except OnlyHereError as error:
            only_here(str(error))
        except PassProcessError as error:
            failed(process, str(error))
    return measure()


def _answer(request: tuple[Sequence[tuple[int, int]], bytes], memory: memoryview
            ) -> Union[PassResult, Exception]:
    """Return the result of a pass, or the error that prevents it."""
    places, text = request
    images = [memory[begin:end] for begin, end in places]
    try:
        measure: Measure = pickle.loads(text, buffers=images)  # noqa: S301 (from our own parent)
    except Exception as error:
        return OnlyHereError(f'the pass cannot be unpickled: {error}')
    try:
        return measure()
    except Exception as error:
        return error


def _pickled(answer: Union[PassResult, Exception]) -> bytes:
    """Return a pickled answer; an error that cannot be pickled becomes a ``RuntimeError``."""
    try:
        return pickle.dumps(answer, protocol=5)
    except Exception as error:
        return pickle.dumps(RuntimeError(f'{answer!r}: {error!r}'))


def main(pipe_fd: int, memory_fd: int) -> None:
    """Measure passes that come through a pipe, until it is closed."""
    leave_ending_to_parent()
    cv2.setNumThreads(1)
    warm_up()
    pipe: Connection[Any, Any] = Connection(pipe_fd)
    try:
        pipe.send('ready')
        while True:
            request = pipe.recv()
            memory = mmap(memory_fd, 0, MAP_PRIVATE)  # mapped anew, as it may have grown
            pipe.send_bytes(_pickled(_answer(request, memoryview(memory))))
    except (EOFError, OSError):  # the parent has ended
        pass


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
