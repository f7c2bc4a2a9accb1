# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Loops that numba compiles if it is installed, each with an equivalent function in plain numpy.

A kernel is a loop over pixels or observations that numpy could only do in many passes, or with
many calls on few of them.  Each has a plain numpy function of the same arguments, which defines
what the kernel computes.  The tests compare the two, and the plain function replaces the kernel if
numba is missing or ``STEREO_SPEED_KERNELS`` is ``plain``.  ``kernels`` returns which of the two is
in use, and why, for logs, diagnostics and ``summary.json``.

A kernel is compiled once, for the types that it declares, and its arguments are converted to
these.  The same arguments therefore give the same bits, whatever the process did before.

Compiled code is cached beside the sources, or in the user's cache folder if that is not writable,
so that only the first run after an installation waits for the compiler.
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


REGISTRY: dict[str, Kernel[..., Any]] = {}  # all kernels imported so far


@dataclass(frozen=True)
class Kernels:
    """
    Which kernels are in use.

    :param compiled: whether they are compiled; otherwise they are plain numpy.
    :param why: version of numba, or the reason why it is not used.
    """

    compiled: bool
    why: str

    def __str__(self) -> str:
        return f'{"compiled" if self.compiled else "plain numpy"} ({self.why})'


@lru_cache(maxsize=1)
def kernels() -> Kernels:
    """
    Return which kernels this process uses; the first call decides for the whole process.

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
    A loop and its plain numpy equivalent; a call runs one of the two.

    :param loop: function that numba compiles; it must not change its arguments.
    :param plain: plain numpy function with the same arguments and result.
    :param types: numba signature of the arguments; arrays are contiguous.
    """

    def __init__(self, loop: Callable[..., Any], plain: Callable[P, R], types: str) -> None:
        self.loop, self.plain, self.types = loop, plain, types
        self._chosen: Optional[Callable[..., R]] = None
        REGISTRY[f'{loop.__module__}.{loop.__name__}'] = self
        update_wrapper(self, plain)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Return the result of the compiled loop, or of the plain function if that is in use."""
        chosen = self._chosen
        if chosen is None:
            chosen = self._chosen = self.compiled() if kernels().compiled else self.plain
        return chosen(*args, **kwargs)

    def warm_up(self) -> None:
        """Compile the loop, or load it from the cache."""
        if self._chosen is None:
            self._chosen = self.compiled()

    def compiled(self) -> Callable[..., R]:
        """
        Return the compiled loop, even if the plain function is in use.

        :raises ImportError: numba cannot be imported.
        """
        return _fitted(self.loop, self.types)


def kernel(plain: Callable[P, R], types: str
           ) -> Callable[[Callable[..., Any]], Kernel[P, R]]:
    """
    Return a decorator that turns a loop into a kernel.

    :param plain: plain numpy function with the same arguments and result.
    :param types: numba signature of the arguments; arrays are contiguous.
    """
    return lambda loop: Kernel(loop, plain, types)


def warm_up() -> Kernels:
    """
    Compile or load all kernels imported so far, so that no pair waits for the compiler.

    :return: which kernels are in use; plain ones need no compilation.
    """
    if kernels().compiled:
        for each in REGISTRY.values():
            each.warm_up()
    return kernels()


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """
    Mark a helper as one to inline into the compiled loops that call it.

    Its name in its module refers to the Python function until the first such loop is compiled,
    and to a compiled function from then on.
    """
    function.__dict__['_inline'] = True
    return function


@lru_cache(maxsize=None)
def _fitted(loop: Callable[..., Any], types: str) -> Callable[..., Any]:
    """Return a loop compiled for these types only; it converts other arguments to them."""
    from numba import types as of
    from numba.core.sigutils import normalize_signature
    from numba.np.numpy_support import as_dtype
    # Declared read-only, array arguments may be writable or not.
    wanted = tuple(of.Array(t.dtype, t.ndim, 'C', readonly=True) if isinstance(t, of.Array) else t
                   for t in normalize_signature(types)[0])  # type: ignore[no-untyped-call]
    compiled = _compiled(loop, wanted)
    dtypes = [as_dtype(t.dtype) if isinstance(t, of.Array) else None for t in wanted]

    def call(*args: Any) -> Any:
        try:
            return compiled(*args)
        except TypeError:  # not compiled for the types of these arguments
            return compiled(*[arg if dtype is None else _fit(arg, dtype)
                              for arg, dtype in zip(args, dtypes, strict=True)])
    return call


def _fit(values: Any, dtype: np.dtype[Any]) -> Any:
    """Return values as a contiguous, aligned array of a type, without a copy where possible."""
    fit = np.ascontiguousarray(values, dtype)
    return fit if fit.flags.aligned else fit.copy()


def _compiled(loop: Callable[..., Any], types: tuple[Any, ...]) -> Callable[..., Any]:
    import numba
    # Helpers are inlined.  Compiled separately, they could come from another compiled module than
    # the loop does, and give other bits.
    _inline_helpers(loop)
    # Reassociation vectorises sums; the chosen flags keep the semantics of NaN and infinity.
    compile_ = partial(numba.njit, types, nogil=True, error_model='numpy',
                       fastmath={'reassoc', 'contract', 'arcp', 'nsz'})
    try:
        compiled: Callable[..., Any] = compile_(cache=True)(loop)
    except RuntimeError:  # no writable folder for the cache
        compiled = compile_()(loop)
    return compiled


def _inline_helpers(function: Callable[..., Any]) -> None:
    """Have the helpers that a function calls, directly or not, inlined into it."""
    import numba
    for name in function.__code__.co_names:
        helper = function.__globals__.get(name)
        if isinstance(helper, FunctionType) and '_inline' in helper.__dict__:
            _inline_helpers(helper)
            function.__globals__[name] = numba.njit(inline='always')(helper)
