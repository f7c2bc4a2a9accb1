# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Ends tracks: has their passes measured, and collects the results."""
from __future__ import annotations

from functools import partial
from typing import Container, Optional, Sequence

from .conclusions import Conclusions
from .open_work import OpenWork
from .roster import Roster
from .stream_doubt import StreamDoubt
from .track import Track
from ..core.passes import PassResult, Reason


class Endings:
    """
    See the module's docstring.

    ``concluding`` are the numbers of the tracks whose passes are being measured.

    :param roster: the tracks; those that end leave it.
    :param open_work: tracks that are solved for beside the pairs end after their turn.
    :param doubt: what is uncertain of the stream.
    :param conclusions: measures passes.
    """

    def __init__(self, roster: Roster, open_work: OpenWork, doubt: StreamDoubt,
                 conclusions: Conclusions) -> None:
        self._roster, self._open, self._doubt = roster, open_work, doubt
        self._conclusions = conclusions
        self.concluding: set[int] = set()

    def done(self, *, everything: bool) -> list[PassResult]:
        """
        Return the passes that have been measured since the last call.

        :param everything: whether to wait for all passes that are over.
        """
        passes = self._conclusions.done(everything=everything)
        self.concluding.difference_update(result.track for result in passes)
        return passes

    def collect(self, *, everything: bool) -> None:
        """
        Have the passes measured that are over.

        A vehicle that left the view before it was confirmed is rejected.  An unconfirmed track
        that was lost, or had just started when the stream ended, gives no pass.

        :param everything: whether all tracks end, as the stream does.
        """
        tracks = self._roster.tracks
        for track in [t for t in tracks if everything or t.ended]:
            tracks.remove(track)
            if track.confirmed or track.detection is None:
                self.conclude(track)
            elif track.ended and track.is_vehicle:
                self.conclude(track, Reason.TOO_FEW_PAIRS)

    def drop_doubles(self, stamp_ns: int, published: Container[int] = ()) -> None:
        """
        End one of two tracks that hold the same vehicle, once its turn is over.

        The parameters are those of :meth:`.roster.Roster.drop_doubles`.
        """
        for track in self._roster.drop_doubles(stamp_ns, published):
            if track.turn is not None:
                self._open.end_later(track)
            else:
                self.conclude(track, Reason.DUPLICATE)

    def conclude(self, track: Track, reason: Optional[Reason] = None) -> None:
        """
        Have the whole pass of an ended track measured.

        :param reason: why the pass is rejected in any case; None to let the measurement decide.
        """
        measure = self._doubt.pass_end(track, reason)
        track.restart_pairs = None  # otherwise the pass process would be sent these images
        self.concluding.add(track.tracker.track)
        self._conclusions.add(measure, partial(self.concluding.discard, track.tracker.track))

    def fail(self, errors: Sequence[Exception]) -> None:
        """Have errors raised where results are collected, as those of passes are."""
        for error in errors:
            self._conclusions.add(partial(_raised, error))


def _raised(error: Exception) -> PassResult:
    """Raise an error in the place of a pass."""
    raise error
