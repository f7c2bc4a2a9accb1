# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Buffer of the latest images as received, in bounded memory."""
from __future__ import annotations

from collections import OrderedDict
from typing import Optional

from .config import EvidenceConfig
from ..io.source_image import SourceImage


class ImageRing:
    """
    Buffers the newest images of both views by their stamps.

    An image far from the others of its side in time is put aside until the next one of that side.
    If both agree, time has jumped, and images of another time are dropped; else its stamp is
    wrong.

    :param most_bytes: greatest total size.
    :param most_ns: greatest time span, ns.
    """

    def __init__(self, most_bytes: int, most_ns: int) -> None:
        self._most_bytes, self._most_ns = most_bytes, most_ns
        self._images: OrderedDict[tuple[int, str], SourceImage] = OrderedDict()
        self._last_ns: dict[str, int] = {}  # stamp of the last image of a side
        self._aside: dict[str, tuple[int, SourceImage]] = {}  # by side
        self.bytes = 0

    @classmethod
    def of(cls, config: EvidenceConfig) -> ImageRing:
        """Return a buffer with the limits of the parameters."""
        return cls(config.ring_mib << 20, round(config.ring_s * 1e9))

    def __len__(self) -> int:
        return len(self._images)

    def add(self, side: str, stamp_ns: int, image: SourceImage) -> None:
        """
        Add an image, and drop the oldest ones beyond the limits.

        :param side: ``left`` or ``right``.
        :param stamp_ns: its header stamp.
        :param image: the image as received.
        """
        aside = self._aside.pop(side, None)
        if abs(stamp_ns - self._last_ns.get(side, stamp_ns)) <= self._most_ns:
            self._keep(side, stamp_ns, image)
        elif aside is not None and abs(stamp_ns - aside[0]) <= self._most_ns:
            self._keep(side, *aside)
            self._keep(side, stamp_ns, image)
        else:
            self._aside[side] = stamp_ns, image

    def _keep(self, side: str, stamp_ns: int, image: SourceImage) -> None:
        key = stamp_ns, side
        self._last_ns[side] = stamp_ns
        if key in self._images:  # sent twice
            self.bytes -= len(self._images.pop(key).data)
        self._images[key] = image
        self.bytes += len(image.data)
        while len(self._images) > 1 and (
                self.bytes > self._most_bytes
                or abs(stamp_ns - next(iter(self._images))[0]) > self._most_ns):
            self.bytes -= len(self._images.popitem(last=False)[1].data)

    def get(self, side: str, stamp_ns: int) -> Optional[SourceImage]:
        """Return the image of a stamp; None where it was dropped or never received."""
        return self._images.get((stamp_ns, side))

    def may_come(self, side: str, stamp_ns: int) -> bool:
        """
        Return whether the image of a stamp may still be on its way.

        It is not once a later one of its side has come, nor if time has jumped back since.
        """
        last_ns = self._last_ns.get(side)
        return self.get(side, stamp_ns) is None and (
            last_ns is None or last_ns < stamp_ns <= last_ns + self._most_ns)
