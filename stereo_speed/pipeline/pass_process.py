# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The process in which passes that are over are measured, beside the pairs that follow.

What is Python takes turns with what else is Python in a process, on however many cores: a pass
that is measured in a thread keeps the readings of the other vehicles waiting.
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

_LEAST_BYTES = 1 << 16  # what is smaller goes through the pipe
_ALIGNED = 64  # bytes, as arrays of numpy are
_PATIENCE = 10  # of the processor: readings come first


class PassProcessError(Exception):
    """The process is of no more use: it has ended, or does not answer."""


class PassProcess(HelperProcess):
    """
    The process; see the module's docstring.

    :param answer_s: that a pass may take; it takes some tenths of a second.
    :param fork: as in :class:`HelperProcess`.
    """

    def __init__(self, answer_s: float = 10.0, *, fork: bool = False) -> None:
        super().__init__(
            'stereo_speed.pipeline.pass_process', answer_s, _PATIENCE, fork=fork)

    def measured(self, measure: Measure) -> PassResult:
        """
        Return the result of a pass.

        :param measure: measures it; it is pickled, with all that it holds.
        :raises PassProcessError: there is no telling.
        :raises OnlyHereError: it cannot be pickled; the next one may be.
        :raises Exception: what measuring it has raised.
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
        """Return the result of a pass, or what measuring it has raised."""
        images: list[memoryview] = []

        def inline(buffer: pickle.PickleBuffer) -> bool:
            raw = buffer.raw()
            if raw.nbytes >= _LEAST_BYTES:
                images.append(raw)
                return False
            return True
        try:
            text = pickle.dumps(measure, protocol=5, buffer_callback=inline)
        except Exception as error:  # whatever a tracker of another package raises then
            raise OnlyHereError(str(error)) from error
        answer: Union[PassResult, Exception] = self.answered((self._shared(images), text))
        return answer

    def _shared(self, images: Sequence[memoryview]) -> list[tuple[int, int]]:
        """Lay images into the shared memory; return where each begins and ends."""
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
    Return the result of a pass by a process, or by this one where that cannot measure it.

    :param process: None where there is none.
    :param measure: measures the pass.
    :param failed: told of the process that is of no more use, and why.
    :param only_here: told why this pass cannot be measured by another process.
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
    """Return the result of a pass, or why it has none."""
    places, text = request
    images = [memory[begin:end] for begin, end in places]
    try:
        measure: Measure = pickle.loads(text, buffers=images)  # noqa: S301 (from our own parent)
    except Exception as error:
        return OnlyHereError(str(error))
    try:
        return measure()
    except Exception as error:
        return error


def _pickled(answer: Union[PassResult, Exception]) -> bytes:
    """Return an answer as bytes; an error that cannot be pickled by its name."""
    try:
        return pickle.dumps(answer, protocol=5)
    except Exception as error:
        return pickle.dumps(RuntimeError(f'{answer!r}: {error!r}'))


def main(pipe_fd: int, memory_fd: int) -> None:
    """Measure what comes through a pipe, until it is closed."""
    leave_ending_to_parent()
    cv2.setNumThreads(1)
    warm_up()
    pipe: Connection[Any, Any] = Connection(pipe_fd)
    try:
        pipe.send('ready')
        while True:
            request = pipe.recv()
            memory = mmap(memory_fd, 0, MAP_PRIVATE)  # all of it, as large as it is by now
            pipe.send_bytes(_pickled(_answer(request, memoryview(memory))))
    except (EOFError, OSError):  # who started this is gone
        pass


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
