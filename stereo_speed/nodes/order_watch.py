# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Checks at intervals, beside the pairs, whether the cameras are swapped."""
from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
import time
from typing import Callable, Optional

from ..core.records import StereoPair
from ..geometry.rig import StereoRig
from ..steadying.view_order import views_crossed

_EVERY_S = 10.0  # interval of looks, each of some 50 ms, nearly all outside the interpreter lock
_CROSSED_S = 1.0  # interval while the views are crossed, so that a repair is noticed soon


class OrderWatch:
    """
    See the module's docstring.

    The first look is waited for, as are all looks while the views are crossed, because nothing may
    be published of crossed views.  Results of other looks are collected with a later pair, so that
    no readings wait for them.

    :param look: returns whether views are crossed, or None where the images do not show it.
    :param clock: steady time, s.
    """

    def __init__(self, look: Callable[[StereoRig, StereoPair], Optional[bool]] = views_crossed,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self._look, self._clock = look, clock
        self._thread = ThreadPoolExecutor(1, 'view order')
        self._coming: Optional[Future[Optional[bool]]] = None
        self._looked_s: Optional[float] = None
        self.crossed = False  # by the last look with a result

    def begin(self, rig: StereoRig, pair: StereoPair) -> None:
        """Begin the first look ahead of the first pair, which waits for its result."""
        if self._looked_s is None and self._coming is None:
            self._coming = self._thread.submit(self._look, rig, pair)

    def take(self, rig: StereoRig, pair: StereoPair) -> bool:
        """Process a pair; return whether the views are crossed by the last known result."""
        first, now_s = self._looked_s is None, self._clock()
        if first or now_s - (self._looked_s or 0.0) > (
                _CROSSED_S if self.crossed else _EVERY_S):
            self._looked_s = now_s
            if self._coming is None:
                self._coming = self._thread.submit(self._look, rig, pair)
        if self._coming is not None and (first or self.crossed or self._coming.done()):
            found, self._coming = self._coming.result(), None
            self.crossed = self.crossed if found is None else found
        return self.crossed

    def close(self) -> None:
        """Shut down the thread."""
        self._thread.shutdown(wait=False, cancel_futures=True)
