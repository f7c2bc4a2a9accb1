# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The distance field of a scene and the local frame along its contours (2010, Section III, eq. 8-10).

Boundaries are the curves between regions of different kinds. They are located to a fraction of a
pixel: the mask of each region is slightly smoothed and its level of one half is traced through the
grid, as the paper smooths its boundaries before use. The field is computed once and looked up by
bilinear interpolation.
"""
from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..core.records import Array

Labels = NDArray[np.uint8]
PATHWAY, ACCESSIBLE, INACCESSIBLE = 255, 128, 0  # grey levels of a map
KINDS = (PATHWAY, ACCESSIBLE, INACCESSIBLE)
_SMOOTHING_PX = 2.0  # smoothing of the masks, which removes the pixel steps of a boundary
_NEAR_PX = 8.0  # nearer than this, the boundary is interpolated linearly between its points
_NEIGHBOURS = 5  # boundary points that are tried as ends of such a line
_JOINED_PX2 = 2.5  # squared distance above which points belong to different curves
_GRADIENT_PX = 1.5  # smoothing of the field before its gradient is taken
_Layers = NDArray[np.float32]


class DistanceField:
    """
    Signed distance to the region boundaries, and contour tangent and normal, at any point.

    Coordinates are pixels (x, y), with the centre of the top-left pixel at (0, 0). Pathways have
    negative, other accessible regions positive and inaccessible regions infinite distance (eq.
    10). A map without boundaries is allowed: its distance is the image's diagonal everywhere.

    :param labels: (H, W) uint8 of 255 pathway, 128 accessible, 0 inaccessible.
    """

    def __init__(self, labels: Labels) -> None:
        self.labels = np.ascontiguousarray(labels)
        self.height, self.width = labels.shape
        self.boundary_px = boundary_points(self.labels)
        self.unsigned_px = _unsigned(self.height, self.width, self.boundary_px)
        sign = np.where(labels == PATHWAY, -1.0, 1.0)
        # finite everywhere for interpolation; the look-up adds infinity
        self.signed_px = (sign * self.unsigned_px).astype(np.float32)
        along_y, along_x = _gradient(_smoothed(self.signed_px))
        slope_y, slope_x = _gradient(self.signed_px)
        # doubling the angles makes opposite gradients, as on both sides of a ridge, agree
        steep = np.maximum(_smoothed(slope_x ** 2 + slope_y ** 2), 1e-6)
        doubled = [_smoothed(slope_x ** 2 - slope_y ** 2) / steep,
                   _smoothed(2.0 * slope_x * slope_y) / steep]
        self._doubled = np.stack(doubled, axis=-1).astype(np.float32)
        # stacked, so that one look-up returns all three
        self._layers = np.stack([self.signed_px, along_x, along_y], axis=-1)

    def accessible(self, xy_px: Array) -> NDArray[np.bool_]:
        """Return which points (..., 2) are accessible; points outside the image count as such."""
        column = np.rint(xy_px[..., 0]).astype(np.intp)
        row = np.rint(xy_px[..., 1]).astype(np.intp)
        within = (column >= 0) & (row >= 0) & (column < self.width) & (row < self.height)
        label = self.labels[row.clip(0, self.height - 1), column.clip(0, self.width - 1)]
        return np.asarray((label != INACCESSIBLE) | ~within)

    def distance(self, xy_px: Array) -> Array:
        """
        Return the weighted distance d (eq. 10) at points.

        :param xy_px: (..., 2), points; outside the image the nearest edge pixel is used.
        :return: (...), px; infinite in inaccessible regions.
        """
        return np.where(self.accessible(xy_px), self.level(xy_px), np.inf)

    def level(self, xy_px: Array) -> Array:
        """Return the distance like :meth:`distance`, but finite in inaccessible regions."""
        return self._sample(self.signed_px[..., None], xy_px)[..., 0]

    def level_and_gradient(self, xy_px: Array) -> tuple[Array, Array]:
        """
        Return the level and its gradient, which is the contour's normal, at points.

        The gradient's length is 1 except near ridges of the field, where two boundaries are
        equally near: there the contour has no tangent and the length approaches 0.

        :param xy_px: (..., 2).
        :return: (...) px, and (..., 2) along x and y.
        """
        found = self._sample(self._layers, xy_px)
        return found[..., 0], found[..., 1:]

    def orientation(self, xy_px: Array) -> Array:
        """
        Return the contours' orientation, also defined on ridges between parallel boundaries.

        :param xy_px: (..., 2).
        :return: (..., 2) along x and y: the normal with its angle doubled; its length is 1 where
            the contours around a point are parallel and approaches 0 where they are not.
        """
        return self._sample(self._doubled, xy_px)

    def _sample(self, layers: _Layers, xy_px: Array) -> Array:
        """Interpolate layers (H, W, C) between the four pixels around each point."""
        x = np.clip(xy_px[..., 0], 0.0, self.width - 1.0)
        y = np.clip(xy_px[..., 1], 0.0, self.height - 1.0)
        column = np.minimum(x.astype(np.intp), max(self.width - 2, 0))
        row = np.minimum(y.astype(np.intp), max(self.height - 2, 0))
        right, below = min(1, self.width - 1), min(1, self.height - 1)
        fx, fy = (x - column)[..., None], (y - row)[..., None]
        upper = layers[row, column] * (1 - fx) + layers[row, column + right] * fx
        lower = layers[row + below, column] * (1 - fx) + layers[row + below, column + right] * fx
        return np.asarray(upper * (1 - fy) + lower * fy)


def _smoothed(field: _Layers) -> _Layers:
    """Smooth the pixel steps of a field (H, W)."""
    return np.asarray(cv2.GaussianBlur(field, (0, 0), _GRADIENT_PX,
                                       borderType=cv2.BORDER_REPLICATE), dtype=np.float32)


def _gradient(field: _Layers) -> tuple[_Layers, _Layers]:
    """Return the derivatives of a field (H, W) along y and along x; 0 where it is 1 px wide."""
    along_y, along_x = (
        np.asarray(np.gradient(field, axis=axis), dtype=np.float32) if field.shape[axis] > 1
        else np.zeros_like(field) for axis in (0, 1))
    return along_y, along_x


def boundary_points(labels: Labels) -> Array:
    """
    Trace the boundaries between the regions, to a fraction of a pixel.

    :param labels: (H, W) uint8.
    :return: (n, 2) points where boundaries cross the lines of the pixel grid, px.
    """
    present = [kind for kind in KINDS if np.any(labels == kind)]
    if len(present) == 1:
        return np.zeros((0, 2))
    found = []
    for kind in present[:1] if len(present) == 2 else present:  # two kinds share one boundary
        mask = (labels == kind).astype(np.float32)
        soft = cv2.GaussianBlur(mask, (0, 0), _SMOOTHING_PX,
                                borderType=cv2.BORDER_REPLICATE) - 0.5
        found += [_crossings(soft), _crossings(soft.T)[:, ::-1]]
    return np.concatenate(found)


def _crossings(field: _Layers) -> Array:
    """Return the points (n, 2), as (x, y), where a field changes sign along its rows."""
    left, right = field[:, :-1], field[:, 1:]
    row, column = np.nonzero((left < 0) != (right < 0))
    a, b = left[row, column], right[row, column]
    return np.stack([column + a / (a - b), row.astype(np.float64)], axis=-1)


def _unsigned(height: int, width: int, boundary_px: Array) -> Array:
    """
    Return each pixel's distance to the boundary (eq. 9), px.

    Near it, the boundary is taken as straight between neighbouring points.
    """
    if len(boundary_px) < 2:
        return np.full((height, width), float(np.hypot(height, width)))
    off_boundary = np.full((height, width), 255, np.uint8)
    column, row = np.rint(boundary_px).astype(np.intp).T
    off_boundary[row, column] = 0
    about = cv2.distanceTransform(off_boundary, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    best = np.empty((height, width))
    tree = cKDTree(boundary_px)
    far = about >= _NEAR_PX  # there the boundary points are dense enough
    best[far] = np.asarray(tree.query(_pixels(far))[0])
    best[~far] = _near_distance(tree, _pixels(~far), boundary_px)
    return best


def _pixels(mask: NDArray[np.bool_]) -> Array:
    """Return the centres (n, 2), as (x, y), of the pixels of a mask."""
    return np.argwhere(mask)[:, ::-1].astype(np.float64)


def _near_distance(tree: cKDTree, pixels: Array, boundary_px: Array) -> Array:
    """
    Return the distance (n,) of pixels to the lines from their nearest point to its neighbours.

    Where three kinds of region meet, most points occur twice, once from each side.
    """
    found = tree.query(pixels, k=min(_NEIGHBOURS, len(boundary_px)))
    distance, near = np.asarray(found[0]), np.asarray(found[1])
    a = boundary_px[near[:, :1]]
    along = boundary_px[near[:, 1:]] - a
    length2 = np.maximum(np.sum(along ** 2, axis=-1), 1e-12)
    offset = pixels[:, None] - a
    share = np.clip(np.sum(offset * along, axis=-1) / length2, 0.0, 1.0)
    gap = np.linalg.norm(offset - share[..., None] * along, axis=-1)
    gap[length2 > _JOINED_PX2] = np.inf
    return np.asarray(np.minimum(distance[:, 0], gap.min(axis=-1)))
