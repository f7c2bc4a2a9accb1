# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A bag as shown on a page: backgrounds without traffic, single pairs, epipolar curves."""
from __future__ import annotations

from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Callable, Optional, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from .draft import Point, VIEWS
from ..core.errors import InputError
from ..core.records import Array, StereoPair
from ..geometry.ray_plane import back_project, Plane
from ..geometry.rig import StereoRig
from ..io.bags import StereoBag
from ..site.refine.empty_road import (
    as_picture, Background, MOST_BYTES, MOST_PAIRS, of_both_views)
from ..site.refine.snap import snap
from ..vision.grey import to_eight_bits

NEAREST_M, FARTHEST_M, PLACES = 3.0, 2000.0, 80  # depths and points of an epipolar curve
PICK_STD_PX = 0.3  # 1-sigma of a careful click
BAND_SIGMAS = 3.0
_KEPT_PAIRS = 24  # number of recently shown pairs that are cached
_MISSES_PX = 2.0  # points this far outside the image are still drawn

Result = TypeVar('Result')


class Scene:
    """
    An open bag and the images made from it; the bag is read in one thread only.

    :param path: the bag.
    :param left: topic of the left images; None finds it.
    :param right: topic of the right images; None finds it.
    :raises BagError: the bag is unusable.
    """

    rig: StereoRig
    views: tuple[Background, Background]
    pair_count: int

    def __init__(self, path: Path, left: Optional[str] = None, right: Optional[str] = None
                 ) -> None:
        self.path = path
        self.thread = ThreadPoolExecutor(1, 'bag')  # the only thread that reads the bag
        self._bag = StereoBag(path, left=left, right=right)
        self._kept: OrderedDict[int, StereoPair] = OrderedDict()
        try:
            self.thread.submit(self._open).result()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the bag."""
        if hasattr(self, 'pair_count'):
            self.thread.submit(self._bag.close).result()
        self.thread.shutdown()

    def _open(self) -> None:
        bag = self._bag.__enter__()
        self.rig, self.pair_count = bag.rig, bag.pair_count
        self._stamps_ns = bag.stamps_ns
        self._index_of = {stamp_ns: index for index, stamp_ns in enumerate(self._stamps_ns)}
        if not bag.pair_count:
            next(bag.pairs())  # raises the error with the reason
        self.spread = self._spread(bag)
        self.views = of_both_views(self.spread, self.path)

    def _spread(self, bag: StereoBag) -> list[StereoPair]:
        """Return pairs evenly spread over the bag, as many as memory allows."""
        size = self.rig.left.width_px * self.rig.left.height_px
        most = max(min(MOST_PAIRS, MOST_BYTES // size), 2)
        chosen = np.unique(np.linspace(0, bag.pair_count - 1, most).round().astype(int))
        return list(bag.pairs_at(chosen.tolist()))

    def pair(self, index: int) -> StereoPair:
        """
        Return one pair; call it in the bag's thread only.

        :param index: index of the pair, from 0.
        :raises InputError: no such pair.
        """
        if not 0 <= index < self.pair_count:
            raise InputError(self.path.name, 'pair', index, f'below {self.pair_count}')
        if index not in self._kept:
            self._kept[index] = next(iter(self._bag.pairs_at([index])))
            while len(self._kept) > _KEPT_PAIRS:
                self._kept.popitem(last=False)
        self._kept.move_to_end(index)
        return self._kept[index]

    def index_of(self, stamp_ns: int) -> Optional[int]:
        """Return the index of the pair with a stamp; None where there is none."""
        return self._index_of.get(stamp_ns)

    def stamp_of(self, index: int) -> Optional[int]:
        """Return the stamp of a pair, ns; None where there is none."""
        return self._stamps_ns[index] if 0 <= index < len(self._stamps_ns) else None

    def run_over(self, work: Callable[[StereoBag], Result]) -> Result:
        """Run a function that reads all pairs; call it in the bag's thread only."""
        return work(self._bag)

    def content_hash(self) -> str:
        """Return the hash of the bag's files; slow, so call it in the bag's thread only."""
        return self._bag.input_hash()

    def background_png(self, view: str) -> bytes:
        """Return one view without its traffic."""
        return as_png(as_picture(self.views[VIEWS.index(view)]))

    def frame_png(self, index: int, view: str) -> bytes:
        """Return one view of one pair; call it in the bag's thread only."""
        pair = self.pair(index)
        return as_png(to_eight_bits(pair.left if view == 'left' else pair.right))

    def snapped(self, view: str, at_px: Array, way: Optional[Array]) -> Optional[Point]:
        """Return a point moved onto a marking nearby; None where there is none."""
        found = snap(self.views[VIEWS.index(view)], at_px, way)
        if found is None:
            return None
        u, v = found.uv_px.round(4).tolist()
        return Point(u, v, round(found.std_px, 4))


def as_png(image: NDArray[np.uint8]) -> bytes:
    """Return an image as PNG."""
    return bytes(cv2.imencode('.png', image, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1].tobytes())


def epipolar_curve(rig: StereoRig, view: str, uv_px: Array) -> Array:
    """
    Return the epipolar curve of a point in the other view: (n, 2) raw pixels, far to near.

    Lens distortion bends the epipolar line; points outside the other image are left out.

    :param rig: the cameras.
    :param view: view of the point, ``left`` or ``right``.
    :param uv_px: (2,), its raw pixel.
    """
    depth = np.geomspace(FARTHEST_M, NEAREST_M, PLACES)[:, None]
    if view == 'left':
        points = depth * rig.left.rays(uv_px)
        other, seen = rig.right, rig.to_right(points)
    else:
        points = (depth * rig.right.rays(uv_px) - rig.t) @ rig.R
        other, seen = rig.left, points
    uv, _ = other.project(seen)
    size = np.array([other.width_px, other.height_px])
    near = ((uv > -_MISSES_PX) & (uv < size - 1 + _MISSES_PX)).all(axis=-1)
    return np.asarray(uv[near & np.isfinite(uv).all(axis=-1)])


def on_plane(rig: StereoRig, plane: Plane, view: str, uv_px: Array) -> Optional[Array]:
    """
    Transfer a point to the other view by a plane; None where the ray does not meet it ahead.

    :param rig: the cameras.
    :param plane: plane of the road, in the left frame.
    :param view: view of the point.
    :param uv_px: (2,), its raw pixel.
    """
    if view == 'left':
        ray, centre = rig.left.rays(uv_px), np.zeros(3)
    else:
        ray, centre = rig.right.rays(uv_px) @ rig.R, -rig.R.T @ rig.t
    ahead = back_project(ray, plane.normal, plane.distance_m - float(plane.normal @ centre))
    left, right, _, _ = rig.project(centre + ahead)
    found = right if view == 'left' else left
    return found if np.isfinite(found).all() else None
