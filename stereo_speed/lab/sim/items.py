# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Objects on the road or beside it, painted in the order of their occlusion."""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from .planes import Box, Eye, Plane
from .surface import Sky
from .texture import Image
from ...core.records import Array


@dataclass(frozen=True, eq=False)
class Footprint:
    """
    The ground area that an object covers, in road coordinates.

    :param along_m: least and greatest distance ahead of the camera, along the road.
    :param across_m: least and greatest distance to the left of the camera, across the road.
    """

    along_m: tuple[float, float]
    across_m: tuple[float, float]

    def behind(self, other: Footprint) -> int:
        """Return 1 if the other one may occlude this one, -1 for the reverse, 0 for neither."""
        for mine, its in ((self.along_m, other.along_m), (self.across_m, other.across_m)):
            # If a line separates both, the one on the camera's side is in front.
            if mine[1] <= its[0]:
                return 0 if mine[1] <= 0 <= its[0] else -1 if its[0] > 0 else 1
            if its[1] <= mine[0]:
                return 0 if its[1] <= 0 <= mine[0] else 1 if mine[0] > 0 else -1
        return 1 if self.along_m[0] > other.along_m[0] else -1


@dataclass(frozen=True, eq=False)
class Item:
    """
    An object to be painted.

    :param footprint: its ground area, for the painting order.
    :param planes: its sides, left optical frame, in the order of drawing.
    :param hull_m: (n, 3), points whose hull is its silhouette.
    :param vehicle: number of the vehicle, or None.
    :param front_m: (4, 3), corners of the tracked front of a vehicle.
    :param lamps_m: (n, 3), lit lamps.
    :param mirrored_m: (n, 3), their mirror images below the road.
    :param lamp_size_m: radius of their glow.
    :param lamp_grey: grey level of lamps that are drawn with the planes; None for glowing lamps.
    """

    footprint: Footprint
    planes: list[Plane]
    hull_m: Array
    vehicle: Optional[int] = None
    front_m: Optional[Array] = None
    lamps_m: Array = field(default_factory=lambda: np.zeros((0, 3)))
    mirrored_m: Array = field(default_factory=lambda: np.zeros((0, 3)))
    lamp_size_m: float = 0.22
    lamp_grey: Optional[float] = None


def faces_camera(eye: Eye, plane: Plane) -> bool:
    """Return whether the textured side of a plane faces a camera."""
    return bool((eye.centre_m - plane.corner_m) @ plane.normal > 0)


def paint(image: Image, eye: Eye, item: Item, sky: Optional[Sky] = None) -> None:
    """Paint an item into an image, in place; without a sky it is in plain daylight."""
    for plane in item.planes:
        if faces_camera(eye, plane):
            eye.draw(image, plane, sky)


def in_order(items: list[Item]) -> list[Item]:
    """Sort items so that each is painted before those that occlude it."""
    left = sorted(items, key=lambda item: -item.footprint.along_m[0])
    out: list[Item] = []
    while left:
        # The farthest one that occludes no other; occlusion of boxes has no cycles.
        free = next((a for a in left if not any(
            b is not a and a.footprint.behind(b.footprint) < 0 for b in left)), left[0])
        left.remove(free)
        out.append(free)
    return out


def glow(image: Image, eye: Eye, item: Item, strength: float) -> None:
    """Add the light of an item's lamps, in place."""
    for lamp in item.lamps_m:
        glow_at(image, eye, lamp, item.lamp_size_m, strength)


def glow_at(image: Image, eye: Eye, lamp: Array, size_m: float, strength: float) -> None:
    """
    Add the light of one lamp, in place.

    :param lamp: (3,), its position, left optical frame, m.
    :param size_m: radius of its glow.
    :param strength: grey level at its centre.
    """
    view = eye.view
    z = float((view.R @ lamp + view.t)[2])
    uv = eye.project(lamp[None])
    if z < 2.0 or not len(uv):
        return
    sigma = max(size_m * view.camera.K[0, 0] / z / 2, 1.0)
    reach = np.array([[-1.0, -1.0], [0.0, 0.0], [1.0, 1.0]]) * 3.2 * sigma
    box = eye.box(uv + reach, 0)
    if box is None:
        return
    u0, u1, v0, v1 = box
    row = np.exp(-np.square((np.arange(u0, u1) - uv[0, 0]) / sigma) / 2)
    column = np.exp(-np.square((np.arange(v0, v1) - uv[0, 1]) / sigma) / 2)
    image[v0:v1, u0:u1] += (strength * np.outer(column, row)).astype(np.float32)


class Visibility:
    """
    Computes the visible share of each tracked front in a view.

    :param eye: the view.
    """

    def __init__(self, eye: Eye) -> None:
        self.eye = eye
        self._mask: NDArray[np.int16] = np.zeros((eye.size[1], eye.size[0]), np.int16)

    def shares(self, items: list[Item]) -> dict[int, float]:
        """
        Return the visible share of each vehicle's front; parts outside the image are invisible.

        :param items: items in the order of painting.
        """
        mask, eye = self._mask, self.eye
        mask[:] = 0
        areas: dict[int, tuple[float, Box]] = {}
        for item in items:
            hull = eye.project(item.hull_m)
            if len(hull) >= 3:
                _fill(mask, np.asarray(cv2.convexHull(hull.astype(np.float32)), float)[:, 0], 0)
            if item.vehicle is None or item.front_m is None:
                continue
            uv = eye.project(item.front_m)
            box = eye.box(uv)
            if len(uv) == 4 and box is not None:
                areas[item.vehicle] = float(cv2.contourArea(uv.astype(np.float32))), box
                _fill(mask, uv, item.vehicle + 1)
        shares = {}
        for number, (area, (u0, u1, v0, v1)) in areas.items():
            count = np.count_nonzero(mask[v0:v1, u0:u1] == number + 1)
            shares[number] = float(min(count / max(area, 1.0), 1.0))
        return shares


def _fill(mask: NDArray[np.int16], uv: Array, value: int) -> None:
    corners = np.clip(np.asarray(uv, dtype=float), -1e4, 1e4)
    cv2.fillConvexPoly(mask, np.round(corners * 16).astype(np.int32), value, cv2.LINE_8, 4)
