# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Make records from images and finished passes, in the same way live and offline."""
from __future__ import annotations

from collections import Counter
from pathlib import Path
import time
from typing import Any, Callable, Iterable, Mapping, Optional

from .decision import ambiguity, calibration_refusal, decide, limit_mps, NoRecord
from .recompute import recompute
from .record import record_files, Setting, Views, Violation
from .ring import ImageRing
from .store import EvidenceStore, Stored, StoreError
from ..core.errors import InputError
from ..core.passes import PassResult
from ..core.trace import PassTrace, TracePair
from ..io.topics import SIDES

Clock = Callable[[], Optional[Mapping[str, Any]]]


class EvidenceRecorder:
    """
    Decides on each pass, and writes a record of each violation.

    :param store: store that records are written to.
    :param setting: what the records have in common.
    :param ring: buffer of the latest images.
    :param clock: returns the state of the system's clock; None where it is not available.
    """

    def __init__(self, store: EvidenceStore, setting: Setting, ring: ImageRing,
                 clock: Optional[Clock] = None) -> None:
        self.store, self.setting, self.ring, self._clock = store, setting, ring, clock
        self.records: list[str] = []
        self.refused: Counter[str] = Counter()

    def offer(self, record_id: str, result: PassResult) -> Optional[Stored]:
        """
        Decide on a finished pass, and record it if it is a violation.

        :param record_id: id of the pass.
        :param result: the pass, measured or rejected, with its trace.
        :return: the record; None where there is none, and the reason is counted.
        :raises StoreError: the disk is full or fails; counted as ``not_stored``.
        """
        found = self.decide(record_id, result)
        return None if isinstance(found, NoRecord) else self.write(found)

    def awaits_images(self, result: PassResult) -> bool:
        """Return whether an image of a pass may still come, so that deciding should wait."""
        return result.trace is not None and any(
            self.ring.may_come(side, ns)
            for pair in result.trace.pairs for side, ns in _image_stamps(pair))

    def decide(self, record_id: str, result: PassResult) -> Violation | NoRecord:
        """
        Return a violation with its images, or the reason for no record, which is counted.

        The arguments are those of :meth:`offer`.
        """
        found = self._decided(record_id, result)
        if isinstance(found, NoRecord):
            self.refused[str(found)] += 1
        return found

    def write(self, violation: Violation) -> Optional[Stored]:
        """
        Write a record, which takes about as long as measuring the pass.

        :return: the record; None where measuring again differs, which is counted.
        :raises StoreError: as for :meth:`offer`.
        """
        there = self.store.find(violation.record_id)
        if there is not None:  # the same pass was offered twice
            return Stored(self.store.folder / violation.record_id, there, anew=False)
        try:
            stored = self._stored(violation)
        except StoreError:
            self.refused[str(NoRecord.NOT_STORED)] += 1
            raise
        if stored is None:
            self.refused[str(NoRecord.NOT_REPRODUCIBLE)] += 1
            return None
        self.records.append(violation.record_id)
        return stored

    def summary(self) -> dict[str, Any]:
        """Return the counts of records, and of passes without one by their reason."""
        return {'records': len(self.records), 'no_record': dict(sorted(self.refused.items()))}

    def delete_older(self, now_ns: int) -> list[str]:
        """
        Delete expired records.

        :param now_ns: the newest stamp; where it is ahead of the system's clock, that is used.
        :return: names of the deleted records.
        """
        return self.store.delete_older(min(now_ns, time.time_ns()),
                                       self.setting.config.evidence.retention_days)

    def _decided(self, record_id: str, result: PassResult) -> Violation | NoRecord:
        setting = self.setting
        limit = limit_mps(setting.place.site.lanes, (result.lane, result.lane_to), result.vehicle,
                          setting.config.decision)
        decision, refused = decide(result, limit, setting.config.decision)
        if refused is not None or decision is None:
            return refused or NoRecord.NOT_MEASURED
        trace = result.trace
        if trace is None:
            return NoRecord.NOT_TRACED
        refused = calibration_refusal(
            setting.place.site.calibrated, result.last_ns, setting.config.decision
            ) or ambiguity(trace, result.smoothed, setting.config.decision)
        if refused is not None:
            return refused
        if setting.config.evidence.unapproved == 'refuse' \
                and setting.approved.unknown(setting.instrument.fingerprints):
            return NoRecord.NOT_APPROVED
        images = self._images(trace)
        if images is None and self.store.find(record_id) is None:
            return NoRecord.IMAGES_MISSING
        if images is not None and _repeated(images):
            return NoRecord.IMAGES_REPEATED
        return Violation(record_id, result, trace, decision, images or [],
                         None if self._clock is None else self._clock())

    def _stored(self, violation: Violation) -> Optional[Stored]:
        """Write a record that can be measured again: with crops, else with whole images."""
        number = self.store.next_number
        for whole in (False, True):
            files, record = record_files(violation, number, self.setting, whole=whole)
            stored = self.store.add(violation.record_id, files, record, self._measures_again)
            if stored is not None:
                return stored
        return None

    def _measures_again(self, folder: Path) -> bool:
        try:
            return recompute(
                folder, self.setting.config.evidence.most_recompute_mps).agrees
        except InputError:  # where crops do not show the first front
            return False

    def _images(self, trace: PassTrace) -> Optional[list[Views]]:
        """Return the images of all pairs of a pass; None where one is no longer buffered."""
        out: list[Views] = []
        for pair in trace.pairs:
            left, right = (self.ring.get(side, ns) for side, ns in _image_stamps(pair))
            if left is None or right is None:
                return None
            out.append((left, right))
        return out


def _image_stamps(pair: TracePair) -> Iterable[tuple[str, int]]:
    """Return the sides of a pair, left and right, with the stamps of their images."""
    return zip(SIDES, (pair.stamp_ns, pair.right_image_ns))


def _repeated(images: list[Views]) -> bool:
    """Return whether a camera repeated an image; it then does not belong to its stamp."""
    return any(one.data == after.data for pair, following in zip(images, images[1:])
               for one, after in zip(pair, following))
