# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What every detector is: pairs in, fronts of vehicles that no track holds yet out.

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
    Where a vehicle was in an earlier pair.

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
    :param std_px: 1-sigma of the quad's place against the vehicle, px.
    :param s_m: arc length of the front along the lane's path, m.
    :param lateral_m: offset of the front's middle to the left of the path, m.
    :param width_m: width of the quad, m.
    :param height_m: height of the quad, m.
    :param speed_mps: speed along the path as the detector saw it, m/s; None where it saw none.
        A track that sees another one stays tentative for a while.
    :param speed_std_mps: its 1-sigma, m/s.
    :param earlier: where it was in an earlier pair, for the track to start there; None where
        that is not known.
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
    :param lateral_m: offset of its middle to the left of the path, m.
    :param width_m: its width, m.
    :param height_m: its height, m.
    :param left_px: (4, 2) its corners in the raw left image, px.
    :param right_px: (4, 2) the same in the raw right image, px.
    """

    lane: str
    s_m: float
    lateral_m: float
    width_m: float
    height_m: float
    left_px: Array
    right_px: Array

    @property
    def finite(self) -> bool:
        """Return whether the place is known at all."""
        return bool(np.isfinite([self.s_m, self.lateral_m]).all())


class Detector(Protocol):
    """Finds vehicles in a stream of pairs."""

    def update(self, pair: StereoPair, tracked: Sequence[TrackedRegion]) -> Sequence[Detection]:
        """
        Take in a pair, in order of stamps, and return the fronts that no track holds yet.

        :param pair: the pair.
        :param tracked: what the tracks hold in it.
        """

    def reset(self) -> None:
        """Forget the pairs so far: time has jumped back."""


@runtime_checkable
class LooksAhead(Protocol):
    """A detector that searches a pair while its tracks are updated."""

    def expect(self, pair: StereoPair, tracked: Sequence[TrackedRegion]) -> None:
        """
        Begin with the pair that ``update`` will be asked for.

        :param pair: the pair.
        :param tracked: what the tracks are expected to hold in it.
        """


@runtime_checkable
class AnswersLater(Protocol):
    """A detector that may still be searching the pair that it was told to expect."""

    def is_ready(self) -> bool:
        """Return whether ``update`` would wait for no search."""


class DetectorType(Protocol):
    """
    A class of detectors, as the registry finds it.

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
    A vehicle in the raw left image, as a detector outside the package found it.

    :param left_px: column of its left edge, px.
    :param top_px: row of its upper edge, px.
    :param width_px: its width, px.
    :param height_px: its height, px.
    :param score: confidence between 0 and 1.
    """

    left_px: float
    top_px: float
    width_px: float
    height_px: float
    score: float = 1.0


@runtime_checkable
class TakesBoxes(Protocol):
    """A detector that is given what another one found, such as a neural network."""

    def offer(self, stamp_ns: int, boxes: Sequence[ImageBox]) -> None:
        """
        Take the boxes of one pair, before or some pairs after the pair itself.

        :param stamp_ns: header stamp of the left image they were found in, ns.
        :param boxes: all of them; none says that there is no vehicle.
        """
