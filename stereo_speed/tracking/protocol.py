# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What every tracker is: pairs in, updates out, one result at the end."""
from __future__ import annotations

from typing import Optional, Protocol, runtime_checkable

from ..core.records import PassResult, StereoPair, TrackUpdate


class Tracker(Protocol):
    """One vehicle followed through the pairs of its pass."""

    track: int

    @property
    def ended(self) -> bool:
        """Whether the pass is over: out of view, or lost for too long."""

    def update(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """
        Take in one pair, in order of stamps.

        :return: None once the pass has ended.
        """

    def result(self) -> PassResult:
        """Measure the pass from all pairs so far."""


@runtime_checkable
class SharesParticles(Protocol):
    """A tracker whose number of particles can change under way."""

    def share(self, particles: int) -> None:
        """Go on with another number of particles, when tracks come and go."""
