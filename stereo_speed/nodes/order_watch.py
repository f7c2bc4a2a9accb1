# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Whether the cameras are in each other's place, by a look now and then beside the pairs."""
from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
import time
from typing import Callable, Optional

from ..core.records import StereoPair
from ..geometry.rig import StereoRig
from ..steadying.view_order import views_crossed

_EVERY_S = 10.0  # between two looks; one takes some 50 ms, nearly all of it outside of Python
_CROSSED_S = 1.0  # the same while they are crossed: who has them so waits for them to be put right


class OrderWatch:
    """
    See the module's docstring.

    The first look is waited for, as are those while the views are crossed: nothing may be told of
    crossed views.  Others are taken in with a later pair, whose readings do not wait for them.

    :param look: tells whether views are crossed; None where the images do not tell.
    :param clock: steady time, s.
    """

    def __init__(self, look: Callable[[StereoRig, StereoPair], Optional[bool]] = views_crossed,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self._look, self._clock = look, clock
        self._thread = ThreadPoolExecutor(1, 'view order')
        self._coming: Optional[Future[Optional[bool]]] = None
        self._looked_s: Optional[float] = None
        self.crossed = False  # as of the last look that told

    def begin(self, rig: StereoRig, pair: StereoPair) -> None:
        """Begin with the first look, which the first pair waits for."""
        if self._looked_s is None and self._coming is None:
            self._coming = self._thread.submit(self._look, rig, pair)

    def take(self, rig: StereoRig, pair: StereoPair) -> bool:
        """Take in a pair; return whether the views are crossed, as far as is known."""
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
        """Let go of the thread."""
        self._thread.shutdown(wait=False, cancel_futures=True)
