# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The interface of detectors: pairs in, fronts of vehicles that no track holds yet out.

Detectors are found by name: those of this package in ``pipeline.registry``, those of other
packages through the entry-point group ``stereo_speed.detectors``.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping, Optional, Protocol, runtime_checkable, Sequence

import numpy as np

from ..core.records import Array, StereoPair
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath


@dataclass(frozen=True, eq=False, kw_only=True)
class EarlierFront:
    """
    The front of a vehicle in an earlier pair.

    :param pairs: that pair and those since, without the newest.
    :param left_px: (4, 2) corners of its front there in the raw left image.
    :param right_px: (4, 2) the same in the raw right image.
    """

    pairs: tuple[StereoPair, ...]
    left_px: Array
    right_px: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Detection:
    """
    A front of a vehicle in one pair.

    :param lane: name of the lane.
    :param left_px: (4, 2) corners in the raw left image, clockwise from the top left.
    :param right_px: (4, 2) the same in the raw right image.
    :param std_px: 1-sigma of the quad's place relative to the vehicle, px.
    :param s_m: arc length of the front along the lane's path, m.
    :param lateral_m: offset of the front's middle to the left of the path, m.
    :param width_m: width of the quad, m.
    :param height_m: height of the quad, m.
    :param speed_mps: speed along the path by the detector, m/s; None where it gives none.  A track
        whose own speed disagrees stays tentative for a while.
    :param speed_std_mps: 1-sigma of that speed, m/s.
    :param earlier: its front in an earlier pair, at which the track starts; None where that is not
        known.
    """

    lane: str
    left_px: Array
    right_px: Array
    std_px: float
    s_m: float
    lateral_m: float
    width_m: float
    height_m: float
    speed_mps: Optional[float] = None
    speed_std_mps: float = 0.0
    earlier: Optional[EarlierFront] = None


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackedRegion:
    """
    A place that a track already holds, predicted for the pair.

    :param lane: name of the lane.
    :param s_m: arc length of the tracked front along the lane's path, m.
    :param lateral_m: offset of the front's middle to the left of the path, m.
    :param width_m: width of the front, m.
    :param height_m: height of the front, m.
    :param left_px: (4, 2) corners of the front in the raw left image, px.
    :param right_px: (4, 2) the same in the raw right image, px.
    :param oncoming: whether its vehicle travels against the direction of the lane.
    """

    lane: str
    s_m: float
    lateral_m: float
    width_m: float
    height_m: float
    left_px: Array
    right_px: Array
    oncoming: bool = False

    @property
    def finite(self) -> bool:
        """Return whether the place is known."""
        return bool(np.isfinite([self.s_m, self.lateral_m]).all())


class Detector(Protocol):
    """Finds vehicles in a stream of pairs."""

    def update(self, pair: StereoPair, tracked: Sequence[TrackedRegion]) -> Sequence[Detection]:
        """
        Process a pair, in order of stamps, and return the fronts that no track holds yet.

        :param pair: the pair.
        :param tracked: regions that tracks hold in it.
        """

    def reset(self) -> None:
        """Discard all earlier pairs, because time has jumped back."""


@runtime_checkable
class LooksAhead(Protocol):
    """A detector that searches a pair while its tracks are updated."""

    def expect(self, pair: StereoPair, tracked: Sequence[TrackedRegion]) -> None:
        """
        Begin to search the pair that ``update`` will be called with.

        :param pair: the pair.
        :param tracked: regions that tracks are expected to hold in it.
        """


@runtime_checkable
class AnswersLater(Protocol):
    """A detector that may still be searching the pair that ``expect`` was called with."""

    def is_ready(self) -> bool:
        """Return whether ``update`` would return without waiting for a search."""


class DetectorType(Protocol):
    """
    A class of detectors, as the registry loads it.

    ``Settings`` is the config record of its own parameters
    (:class:`..core.config.NoParameters` where it has none).
    """

    Settings: type[Any]

    def __call__(self, rig: StereoRig, lanes: Mapping[str, LanePath], settings: Any) -> Detector:
        """
        Return a detector.

        :param rig: the cameras.
        :param lanes: lane name to lane path.
        :param settings: a record of its ``Settings``.
        """


@dataclass(frozen=True, kw_only=True)
class ImageBox:
    """
    The box of a vehicle in the raw left image, found by a detector outside the package.

    :param left_px: column of its left edge, px.
    :param top_px: row of its upper edge, px.
    :param width_px: width of the box, px.
    :param height_px: height of the box, px.
    :param score: confidence between 0 and 1.
    """

    left_px: float
    top_px: float
    width_px: float
    height_px: float
    score: float = 1.0


@runtime_checkable
class TakesBoxes(Protocol):
    """A detector that uses the boxes of another one, such as a neural network."""

    def offer(self, stamp_ns: int, boxes: Sequence[ImageBox]) -> None:
        """
        Take the boxes of one pair, before or some pairs after the pair itself.

        :param stamp_ns: header stamp of the left image that they were found in, ns.
        :param boxes: all boxes of that image; an empty sequence means that there is no vehicle.
        """
