# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The focus of the cameras: by how much the right view of a stream is more blurred."""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Any, Optional

from ..core.records import StereoPair
from ..vision.relative_blur import relative_blur

_LOOK_S = 2.0  # time between two looks; focus changes slowly
_NEW_SHARE = 0.1  # least weight of a look in the running mean
_TOLD_PX = 1.0  # difference of blur from which a user is told
_DIGITS = 2  # decimals of a blur


@dataclass(frozen=True)
class Focus:
    """
    What is known of the focus.

    :param looks: number of pairs that told it.
    :param unknown: number of pairs looked at that show too few details to tell.
    :param blur_px2: squared blur of the right view less that of the left one, px^2.
    """

    looks: int = 0
    unknown: int = 0
    blur_px2: float = 0.0

    @property
    def blur_px(self) -> float:
        """Return the blur, 1-sigma, px: of the right view, or of the left one if negative."""
        return math.copysign(math.sqrt(abs(self.blur_px2)), self.blur_px2)

    def summary(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return {'looks': self.looks, 'unknown': self.unknown,
                'right_blur_px': round(self.blur_px, _DIGITS) + 0.0}

    def warning(self) -> str:
        """Return a warning for the user; empty if both views are about equally sharp."""
        if abs(self.blur_px) < _TOLD_PX:
            return ''
        worse, better = ('right', 'left') if self.blur_px > 0 else ('left', 'right')
        return (f'the {worse} camera is out of focus: its view is more blurred than the {better} '
                f'one, by a 1-sigma of {abs(self.blur_px):.1f} px')


class ViewFocus:
    """Estimates the focus pair by pair; ``state`` is what is known of it."""

    def __init__(self) -> None:
        self.state = Focus()
        self._last_ns: Optional[int] = None

    def restart(self) -> None:
        """Look at the next pair, whatever its stamp, as after a jump back in time."""
        self._last_ns = None

    def seen(self, pair: StereoPair) -> StereoPair:
        """Return a pair with the difference of blur filled in."""
        if self._last_ns is None or pair.stamp_ns - self._last_ns >= _LOOK_S * 1e9:
            self._last_ns = pair.stamp_ns
            self._look(pair)
        return replace(pair, blur_px2=self.state.blur_px2) if self.state.blur_px2 else pair

    def _look(self, pair: StereoPair) -> None:
        """Update what is known by a pair."""
        found, known = relative_blur(pair.left, pair.right), self.state
        if found is None:
            self.state = replace(known, unknown=known.unknown + 1)
            return
        share = max(1 / (known.looks + 1), _NEW_SHARE)
        self.state = replace(known, looks=known.looks + 1, blur_px2=(
            known.blur_px2 + share * (found.px2 - known.blur_px2)))
