# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Loops that numba compiles where it is installed, each beside the same in plain numpy.

A kernel is a loop over pixels or observations that numpy can only do in many passes.  Beside it
stands a function of the same arguments in plain numpy, which says what the kernel computes, is
what the tests hold it to, and takes its place where numba is missing or ``STEREO_SPEED_KERNELS``
is ``plain``.  Which of the two is in use, and why, is never left to be guessed: ``kernels``
returns it for logs, diagnostics and ``summary.json``.

A kernel is compiled once, for the types that it declares, and arguments are brought to those: the
same arguments give the same bits, whatever a process did before.

Compiled code is kept beside the sources, or in the user's cache folder where these cannot be
written, so that only the first run after an installation waits for the compiler.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial, update_wrapper
import os
from types import FunctionType
from typing import Any, Callable, Generic, Optional, ParamSpec, TypeVar

import numpy as np

P = ParamSpec('P')
R = TypeVar('R')

VARIABLE = 'STEREO_SPEED_KERNELS'
_CHOICES = ('compiled', 'plain')


REGISTRY: dict[str, Kernel[..., Any]] = {}  # every kernel that was imported


@dataclass(frozen=True)
class Kernels:
    """
    Which kernels are in use.

    :param compiled: whether they are compiled; else they are plain numpy.
    :param why: the version of numba, or the reason why it is not used.
    """

    compiled: bool
    why: str

    def __str__(self) -> str:
        return f'{"compiled" if self.compiled else "plain numpy"} ({self.why})'


@lru_cache(maxsize=1)
def kernels() -> Kernels:
    """
    Return which kernels this process uses; the first call decides for all that follow.

    :raises ValueError: ``STEREO_SPEED_KERNELS`` is neither ``compiled`` nor ``plain``.
    :raises ImportError: it is ``compiled``, and numba cannot be imported.
    """
    wanted = os.environ.get(VARIABLE, '')
    if wanted and wanted not in _CHOICES:
        raise ValueError(f'{VARIABLE} is {wanted!r}, wanted one of ' + ', '.join(_CHOICES))
    if wanted == 'plain':
        return Kernels(False, f'{VARIABLE}=plain')
    try:
        import numba
    except ImportError as error:
        if wanted:
            raise
        return Kernels(False, f'numba: {error}')
    return Kernels(True, f'numba {numba.__version__}')


class Kernel(Generic[P, R]):
    """
    A loop, and the same in plain numpy; calling it calls one of the two.

    :param loop: what numba compiles; it changes none of its arguments.
    :param plain: takes and returns the same.
    :param types: those of the arguments, in numba's words; arrays are contiguous.
    """

    def __init__(self, loop: Callable[..., Any], plain: Callable[P, R], types: str) -> None:
        self.loop, self.plain, self.types = loop, plain, types
        self._chosen: Optional[Callable[..., R]] = None
        REGISTRY[f'{loop.__module__}.{loop.__name__}'] = self
        update_wrapper(self, plain)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Return what the compiled loop returns, or the plain function where there is none."""
        chosen = self._chosen
        if chosen is None:
            chosen = self._chosen = self.compiled() if kernels().compiled else self.plain
        return chosen(*args, **kwargs)

    def warm_up(self) -> None:
        """Compile it, or load what was compiled."""
        if self._chosen is None:
            self._chosen = self.compiled()

    def compiled(self) -> Callable[..., R]:
        """
        Return the compiled loop, whatever is in use.

        :raises ImportError: numba cannot be imported.
        """
        return _fitted(self.loop, self.types)


def kernel(plain: Callable[P, R], types: str
           ) -> Callable[[Callable[..., Any]], Kernel[P, R]]:
    """
    Make a loop a kernel, by decorating it.

    :param plain: the same in plain numpy.
    :param types: those of the arguments, in numba's words; arrays are contiguous.
    """
    return lambda loop: Kernel(loop, plain, types)


def warm_up() -> Kernels:
    """
    Compile all kernels that were imported, or load them, so that no pair waits for the compiler.

    :return: which kernels are in use; where these are plain there is nothing to do.
    """
    if kernels().compiled:
        for one in REGISTRY.values():
            one.warm_up()
    return kernels()


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """
    Mark a helper that becomes part of the compiled loops that call it.

    Its module's name for it stands for a function of Python until one of those is compiled, and
    for a compiled one from then on.
    """
    function.__dict__['_inline'] = True
    return function


@lru_cache(maxsize=None)
def _fitted(loop: Callable[..., Any], types: str) -> Callable[..., Any]:
    """Return a loop compiled for these types alone, which takes what can be brought to them."""
    from numba import types as of
    from numba.core.sigutils import normalize_signature
    from numba.np.numpy_support import as_dtype
    # what cannot be written to fits as well
    wanted = tuple(of.Array(t.dtype, t.ndim, 'C', readonly=True) if isinstance(t, of.Array) else t
                   for t in normalize_signature(types)[0])  # type: ignore[no-untyped-call]
    compiled = _compiled(loop, wanted)
    dtypes = [as_dtype(t.dtype) if isinstance(t, of.Array) else None for t in wanted]

    def call(*args: Any) -> Any:
        try:
            return compiled(*args)
        except TypeError:  # not compiled for these
            return compiled(*[arg if dtype is None else _fit(arg, dtype)
                              for arg, dtype in zip(args, dtypes, strict=True)])
    return call


def _fit(values: Any, dtype: np.dtype[Any]) -> Any:
    """Return values as a contiguous array of a type; themselves where they are one."""
    fit = np.ascontiguousarray(values, dtype)
    return fit if fit.flags.aligned else fit.copy()


def _compiled(loop: Callable[..., Any], types: tuple[Any, ...]) -> Callable[..., Any]:
    import numba
    # Helpers become part of the loop.  As functions of their own they could come from another
    # module of the compiler's than the loop does, with other bits, where it was not loaded.
    _inline_helpers(loop)
    # reassociation lets sums run in vector registers; NaN and infinities keep their meaning
    compile_ = partial(numba.njit, types, nogil=True, error_model='numpy',
                       fastmath={'reassoc', 'contract', 'arcp', 'nsz'})
    try:
        compiled: Callable[..., Any] = compile_(cache=True)(loop)
    except RuntimeError:  # no folder to keep the compiled code in
        compiled = compile_()(loop)
    return compiled


def _inline_helpers(function: Callable[..., Any]) -> None:
    """Have helpers that a function calls compiled into it, and those that they call."""
    import numba
    for name in function.__code__.co_names:
        helper = function.__globals__.get(name)
        if isinstance(helper, FunctionType) and '_inline' in helper.__dict__:
            _inline_helpers(helper)
            function.__globals__[name] = numba.njit(inline='always')(helper)
