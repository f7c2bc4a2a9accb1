# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Image pyramids, sampled at the level that suits the spacing of the samples."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Optional, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.records import Array, StereoPair
from ..geometry.rig import StereoRig
from ..geometry.steadied import moved_px
from ..vision.relative_blur import equally_sharp

Patches = NDArray[np.float32]

LEVELS = 4
_MARGIN_PX = 40  # reach of the blur of the coarsest level
_MAX_ROWS = 1 << 14  # cv2.remap takes maps of fewer than 32768 rows
_NODES = 5  # points across and down an image to which its motion is fitted


class Region(NamedTuple):
    """A region of an image: first column and row, and column and row after the last."""

    left: int
    top: int
    right: int
    bottom: int

    def cut(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return this region of an image."""
        return image[self.top:self.bottom, self.left:self.right]


class PairRegions(NamedTuple):
    """The regions of both images that a detector looks at."""

    left: Region
    right: Region


@dataclass(frozen=True, eq=False)
class Pyramid:
    """
    One image at full, half, quarter and eighth size.

    :param levels: float32 grey images, the first of full size.
    :param origin_px: column and row of the image at which they begin.
    :param motion: (3, 2) affine map from pixels (u, v, 1) of an unmoved rig to those of the image,
        accurate to a few tenths of a pixel at its edges; None where the rig has not moved.
    """

    levels: tuple[Patches, ...]
    origin_px: tuple[int, int]
    motion: Optional[Patches] = None

    @classmethod
    def of(cls, image: NDArray[Any], region: Region, motion: Optional[Patches] = None
           ) -> Pyramid:
        """Build the pyramid of the image (H, W) of a region."""
        levels = [image.astype(np.float32)]
        for _ in range(LEVELS - 1):
            levels.append(np.asarray(cv2.pyrDown(levels[-1]), dtype=np.float32))
        return cls(tuple(levels), (region.left, region.top), motion)

    def places(self, step_px: int) -> NDArray[np.float32]:
        """Return the pixels (n, 2) of the full size on a grid of this spacing."""
        (height, width), (left, top) = self.levels[0].shape, self.origin_px
        v, u = np.mgrid[top:top + height:step_px, left:left + width:step_px]
        return np.stack([u.ravel(), v.ravel()], axis=-1).astype(np.float32)

    def pick(self, uv_px: NDArray[np.float32]) -> Patches:
        """Return the grey values (n,) of the full-size pixels nearest to pixels (n, 2)."""
        u, v = np.round(self._moved(uv_px) - self.origin_px).astype(int).T
        height, width = self.levels[0].shape
        return np.asarray(self.levels[0][np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)])

    def _moved(self, uv_px: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the pixels of the image for pixels of an unmoved rig."""
        if self.motion is None:
            return uv_px
        return np.asarray(uv_px @ self.motion[:2] + self.motion[2], np.float32)

    def sample(self, uv_px: NDArray[np.float32], level: int) -> Patches:
        """
        Sample one level; the border is repeated outside.

        :param uv_px: (..., W, 2) full-size pixels of an unmoved rig, finite.
        :param level: number of the level, 0 for full size.
        """
        scale = np.float32(0.5 ** level)
        shift = (0.5 - np.array(self.origin_px, np.float32)) * scale - np.float32(0.5)
        shift = shift.astype(np.float32)
        flat: Any = self._moved(uv_px).reshape(-1, *uv_px.shape[-2:]) * scale + shift
        out = np.empty(flat.shape[:2], np.float32)
        for k in range(0, len(flat), _MAX_ROWS):
            out[k:k + _MAX_ROWS] = cv2.remap(
                self.levels[level], flat[k:k + _MAX_ROWS], None,  # type: ignore[call-overload]
                cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return out.reshape(uv_px.shape[:-1])


@dataclass(frozen=True, eq=False)
class PairPyramids:
    """
    Both views of a pair.

    :param pair: the pair itself.
    :param left: left view.
    :param right: right view.
    """

    pair: StereoPair
    left: Pyramid
    right: Pyramid

    @classmethod
    def of(cls, pair: StereoPair, regions: PairRegions, rig: StereoRig) -> PairPyramids:
        """
        Build the pyramids of a region of each image, with both views equally sharp.

        :param pair: the pair.
        :param regions: the regions.
        :param rig: the cameras.
        """
        images = equally_sharp(
            regions.left.cut(pair.left), regions.right.cut(pair.right), pair.blur_px2)
        return cls(pair, *(
            Pyramid.of(image, region, _motion(pair, rig, region, side))
            for side, (image, region) in enumerate(zip(images, regions))))

    def age_s(self, stamp_ns: int) -> float:
        """Return the time from this pair to a stamp, s."""
        return (stamp_ns - self.pair.stamp_ns) * 1e-9


def _motion(pair: StereoPair, rig: StereoRig, region: Region, right: int) -> Optional[Patches]:
    """Return the affine motion of one view, as in :class:`Pyramid`."""
    if pair.motion is None:
        return None
    u, v = np.meshgrid(np.linspace(region.left, region.right, _NODES),
                       np.linspace(region.top, region.bottom, _NODES))
    uv = np.stack([u.ravel(), v.ravel()], axis=-1)
    moved = moved_px(rig, rig.as_taken(pair.motion), bool(right), uv)
    fit = np.linalg.lstsq(np.column_stack([uv, np.ones(len(uv))]), moved, rcond=None)[0]
    return np.asarray(fit, np.float32)


def region_of(pixels: Sequence[Patches], size: tuple[int, int]) -> Region:
    """
    Bound pixels by a region of an image, with a margin for the coarsest level.

    :param pixels: arrays (..., 2); pixels far outside the image do not count.
    :param size: width and height of the image.
    """
    last = np.array(size)
    low, high = last.copy(), np.zeros(2, int)
    for uv in pixels:
        flat = uv.reshape(-1, 2)
        flat = flat[((flat > -_MARGIN_PX) & (flat < last + _MARGIN_PX)).all(axis=1)]
        if len(flat):
            low = np.minimum(low, flat.min(axis=0).astype(int) - _MARGIN_PX)
            high = np.maximum(high, flat.max(axis=0).astype(int) + _MARGIN_PX)
    low, high = np.clip(low, 0, last - 1), np.clip(high, 1, last)
    low = np.minimum(low, high - 1)
    return Region(int(low[0]), int(low[1]), int(high[0]), int(high[1]))


def level_of(step_px: Array) -> NDArray[np.int64]:
    """Return the coarsest level with pixels no larger than steps (...,) of full-size pixels."""
    with np.errstate(invalid='ignore'):
        levels = np.floor(np.log2(np.fmax(step_px, 1.0)))  # 1 px where the step is NaN
    return np.clip(levels, 0, LEVELS - 1).astype(np.int64)
