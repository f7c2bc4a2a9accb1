# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The life cycle of a track, shared by all trackers: confirmed, coasting, lost, out of view."""
from __future__ import annotations

from typing import Optional

import numpy as np

from .protocol import TrackStart
from ..core.passes import TrackEnd
from ..core.records import Array, StereoPair, TrackState


_RECEDED = 0.9  # share of its greatest extent below which a front has receded


class TrackLife:
    """
    Records in which pairs a vehicle was seen, and derives its state by ``VisibilityConfig``.

    ``first_ns`` is the stamp of the first pair.  ``stamps_ns`` are the stamps of the pairs that
    showed the whole front.  ``extent_px`` is the greatest extent of the front in the left view.
    ``end`` is how the pass ended, None until then.

    :param start: what the track starts from.
    """

    def __init__(self, start: TrackStart) -> None:
        self.rig, self.limits = start.rig, start.config.visibility
        self.stamps_ns: list[int] = []
        self.extent_px = 0.0
        self.end: Optional[TrackEnd] = None
        self.first_ns = self._last_ns = self._seen_ns = start.pair.stamp_ns

    def advance_s(self, pair: StereoPair) -> float:
        """Advance to a pair; return the time since the last one, s."""
        passed_s = (pair.stamp_ns - self._last_ns) * 1e-9
        self._last_ns = pair.stamp_ns
        return passed_s

    def leaves_view(self, left_px: Array, right_px: Array) -> bool:
        """
        End the pass if a front is not wholly in both images; return whether it is over.

        :param left_px: (4, 2) corners of the front in the left view.
        :param right_px: (4, 2) corners of the front in the right view.
        """
        if not self.is_in_view(left_px, right_px):
            self.end = TrackEnd.LEFT_VIEW
        return self.end is not None

    def is_in_view(self, left_px: Array, right_px: Array) -> bool:
        """Return whether a front (4, 2) is wholly in both images."""
        return self.rig.left.holds(left_px) and self.rig.right.holds(right_px)

    def is_too_far(self, left_px: Array) -> bool:
        """
        Return whether a front (4, 2) has receded until it is too small.

        One that approaches may be annotated when it is still as small.
        """
        return extent_px(left_px) < min(self.limits.least_width_px, _RECEDED * self.extent_px)

    def seen(self, pair: StereoPair, left_px: Array) -> TrackState:
        """
        Register a pair that shows the whole front.

        :param left_px: (4, 2) corners of the front in the left view.
        :return: the state of the track.
        """
        self._seen_ns = pair.stamp_ns
        self.stamps_ns.append(pair.stamp_ns)
        self.extent_px = max(self.extent_px, extent_px(left_px))
        confirmed = len(self.stamps_ns) >= self.limits.confirm_pairs
        return TrackState.CONFIRMED if confirmed else TrackState.TENTATIVE

    def coasts(self, pair: StereoPair, *, partly_seen: bool = False) -> bool:
        """
        Register a pair that does not show the whole front; end the pass if this lasts too long.

        :param partly_seen: whether the pair shows a part of the front.
        :return: whether the track goes on.
        """
        if partly_seen:
            self._seen_ns = pair.stamp_ns
        if self.is_lost_by(pair.stamp_ns):
            self.end = TrackEnd.LOST
        return self.end is None

    def is_lost_by(self, stamp_ns: int) -> bool:
        """Return whether a front that a pair does not show has been unseen for too long."""
        unoccluded_ns = self.stamps_ns[-1] if self.stamps_ns else self.first_ns
        return (stamp_ns - self._seen_ns) * 1e-9 > self.limits.lost_after_s \
            or (stamp_ns - unoccluded_ns) * 1e-9 > self.limits.occluded_for_s


def extent_px(quad_px: Array) -> float:
    """
    Return the width or the height of a quad (4, 2) in an image, whichever is greater, px.

    The front of a motorcycle is half a metre wide but higher than that, and so shows as much as a
    car's bumper of twice the width.
    """
    return float(np.ptp(quad_px, axis=0).max())
