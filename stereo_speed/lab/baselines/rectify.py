# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Rectified regions and their disparity: parallel virtual cameras for any rig and lens.

Both virtual cameras look perpendicular to the baseline (A. Fusiello, E. Trucco, A. Verri, "A
compact algorithm for rectification of stereo pairs", Machine Vision and Applications 12, 2000);
only the needed region is warped.  Disparity is by OpenCV's semi-global matching (H. Hirschmuller,
PAMI 30(2), 2008).
"""
from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ...core.records import Array
from ...geometry.rig import StereoRig

_BLOCK = 5  # side of the matching windows, px
_STEP = 16  # OpenCV requires the number of disparities to be a multiple of this
_FRACTION = 16  # OpenCV returns disparities in units of this fraction of a pixel


class Rectifier:
    """
    The virtual cameras of a rig.

    :param rig: the cameras.
    """

    def __init__(self, rig: StereoRig) -> None:
        self.rig = rig
        centre = -rig.R.T @ rig.t
        x = centre / np.linalg.norm(centre)
        forward = np.array([0.0, 0.0, 1.0]) + rig.R[2]
        y = np.cross(forward, x)
        y /= np.linalg.norm(y)
        self.rotation = np.stack([x, y, np.cross(x, y)])  # left frame to virtual frame
        self.f_px = float(rig.left.K[1, 1])

    def project(self, points_m: Array, late_m: Array) -> tuple[Array, Array]:
        """
        Project points into the left virtual camera, whose principal point is (0, 0).

        :param points_m: (..., 3), left optical frame.
        :param late_m: (..., 3), their positions at the exposure of the right view.
        :return: (..., 2) px and (...,) disparities in px.
        """
        at, late = np.asarray(points_m) @ self.rotation.T, np.asarray(late_m) @ self.rotation.T
        z, z_late = (np.where(p[..., 2] > 1e-6, p[..., 2], np.nan) for p in (at, late))
        right = (late[..., 0] - self.rig.baseline_m) / z_late
        return self.f_px * at[..., :2] / z[..., None], self.f_px * (at[..., 0] / z - right)

    def region(self, image: NDArray[np.uint8], right: bool, low: Array, size: tuple[int, int]
               ) -> NDArray[np.uint8]:
        """
        Return a region of a raw view warped into the virtual camera.

        :param right: whether the image is the right view.
        :param low: (2,) its first column and row in the virtual image, px.
        :param size: width and height, px.
        """
        u, v = np.meshgrid(low[0] + np.arange(size[0]), low[1] + np.arange(size[1]))
        rays = np.stack([u / self.f_px, v / self.f_px, np.ones_like(u)], axis=-1) @ self.rotation
        camera = self.rig.right if right else self.rig.left
        rays = rays @ self.rig.R.T if right else rays
        uv = camera.distort(rays[..., :2] / rays[..., 2:]).astype(np.float32)
        out = cv2.remap(image, uv[..., 0], uv[..., 1], cv2.INTER_LINEAR,
                        borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        return np.asarray(out, np.uint8)

    def disparity(self, left: NDArray[np.uint8], right: NDArray[np.uint8], low: Array, high: Array,
                  span_px: tuple[float, float]) -> NDArray[np.float32]:
        """
        Return the disparities of a region, px; NaN where there is none.

        :param left: raw left view, 8 bits.
        :param right: raw right view, 8 bits.
        :param low: (2,), first column and row of the region in the virtual image, whole px.
        :param high: (2,), column and row after the last ones.
        :param span_px: least and greatest disparity to search.
        """
        least = int(np.floor(span_px[0]))
        count = _STEP * max(1, int(np.ceil((span_px[1] - least) / _STEP)))
        # The matcher skips columns without the full range of disparities.
        margin = max(least + count, 0) + _BLOCK
        start = low - [margin, 0]
        size = (int(high[0] - start[0]) + max(-least, 0) + _BLOCK, int(high[1] - low[1]))
        matcher = cv2.StereoSGBM.create(
            minDisparity=least, numDisparities=count, blockSize=_BLOCK, P1=8 * _BLOCK ** 2,
            P2=32 * _BLOCK ** 2, disp12MaxDiff=1, uniquenessRatio=5,
            mode=cv2.STEREO_SGBM_MODE_SGBM)
        raw = matcher.compute(self.region(left, False, start, size),
                              self.region(right, True, start, size))
        out = np.where(raw >= _FRACTION * least, raw / np.float32(_FRACTION),
                       np.float32(np.nan))
        wide = int(high[0] - low[0])
        return np.asarray(out[:, margin:margin + wide], np.float32)
