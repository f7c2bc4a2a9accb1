# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A stereo rig: two cameras fixed to each other, not necessarily parallel."""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Optional, Sequence, Union

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .camera import Camera
from .projection import projected, Projection
from ..core.errors import CalibrationError, InputError
from ..core.records import Array, RigMotion, StereoPair

Angles = Union[Sequence[float], Array]  # (3,) pan, tilt and roll


def of_camera(angles_rad: Angles) -> Array:
    """
    Return the rotation (3, 3) that takes points to the frame of a camera that has rotated.

    :param angles_rad: (3,) pan to the right, tilt upwards and roll clockwise: components of one
        rotation vector about the camera's y, x and z axis.
    """
    pan, tilt, roll = (float(angle) for angle in angles_rad)
    return np.asarray(Rotation.from_rotvec((tilt, pan, roll)).as_matrix().T)


def angles_of(rotation: Array) -> Array:
    """
    Return the angles (3,) of a rotation as :func:`of_camera` takes them, rad.

    :param rotation: (3, 3), takes points to the frame of a camera that has rotated.
    """
    tilt, pan, roll = Rotation.from_matrix(rotation.T).as_rotvec()
    return np.array([pan, tilt, roll])


@dataclass(frozen=True, eq=False)
class StereoRig:
    """
    A calibrated stereo rig: ``x_right = R x_left + t``.

    :param left: left camera, whose frame is that of all geometry.
    :param right: right camera.
    :param R: (3, 3) rotation from the left to the right camera's frame.
    :param t: (3,) the left camera's centre in the right camera's frame, m.
    :param frame_id: name of the left optical frame.
    :param drift_rad: pan, tilt and roll of the right camera since its calibration, rad; ``R`` and
        ``t`` already contain them.
    """

    left: Camera
    right: Camera
    R: Array
    t: Array
    frame_id: str = 'stereo_left_optical_frame'
    drift_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for key, shape in (('R', (3, 3)), ('t', (3,))):
            array = np.array(getattr(self, key), dtype=np.float64).reshape(shape)
            if not np.all(np.isfinite(array)):
                raise CalibrationError('rig', key, array.ravel().tolist(), 'finite numbers')
            array.setflags(write=False)
            object.__setattr__(self, key, array)
        if np.abs(self.R @ self.R.T - np.eye(3)).max() > 1e-5 or np.linalg.det(self.R) < 0:
            raise CalibrationError('rig', 'R', self.R.ravel().tolist(), 'a rotation')
        if not self.baseline_m > 0:
            raise CalibrationError('rig', 'baseline', f'{self.baseline_m} m', 'more than 0')

    def drifted(self, drift_rad: Angles) -> StereoRig:
        """
        Return the rig after a rotation of its right camera about its own centre.

        :param drift_rad: (3,) pan to the right, tilt upwards and roll clockwise: components of
            one rotation vector about the right camera's y, x and z axis.
        """
        pan, tilt, roll = (float(angle) for angle in drift_rad)
        rotation, before = of_camera(drift_rad), self.drift_rad
        return replace(self, R=rotation @ self.R, t=rotation @ self.t, drift_rad=(
            before[0] + pan, before[1] + tilt, before[2] + roll))

    def swayed(self, sway_rad: Angles) -> StereoRig:
        """
        Return the rig after a rotation of the whole rig about its left camera's centre.

        Points and rays of the left camera stay in the frame before the rotation, which is that of
        the site.

        :param sway_rad: (3,) pan to the right, tilt upwards and roll clockwise, as in
            :meth:`drifted`, about the left camera's axes.
        """
        rotation = of_camera(sway_rad)
        before = np.eye(3) if self.left.rotation is None else self.left.rotation
        total = rotation @ before
        return replace(self, left=replace(self.left, rotation=total), R=self.R @ before.T @ total)

    def as_taken(self, motion: Optional[RigMotion]) -> StereoRig:
        """
        Return the rig as it stood when a pair was taken, unchanged if it had not moved.

        :param motion: motion of the pair, see :class:`..core.records.StereoPair`.
        """
        if motion is None:
            return self
        rig = self.drifted(motion.drift_rad) if any(motion.drift_rad) else self
        return rig.swayed(motion.sway_rad) if any(motion.sway_rad) else rig

    def check_sizes(self, pair: StereoPair) -> None:
        """
        Check the images of a pair against the calibration.

        :raises InputError: an image has another size.
        """
        for side, image, camera in (('left', pair.left, self.left),
                                    ('right', pair.right, self.right)):
            if image.shape != (camera.height_px, camera.width_px):
                raise InputError(
                    f'pair {pair.index}', f'{side} image size',
                    f'{image.shape[1]}x{image.shape[0]}',
                    f'{camera.width_px}x{camera.height_px} as calibrated')

    @property
    def baseline_m(self) -> float:
        """Return the distance between the two cameras, m."""
        return float(np.linalg.norm(self.t))

    @cached_property
    def essential(self) -> Array:
        """Return E (3, 3) with ``x_right^T E x_left = 0`` in normalised coordinates."""
        x, y, z = self.t
        return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ self.R

    def to_right(self, points_m: Array) -> Array:
        """
        Return points transformed from the left camera's frame to the right camera's.

        :param points_m: (..., 3) points, m.
        """
        return np.asarray(points_m, dtype=np.float64) @ self.R.T + self.t

    def project(self, points_m: Array, later_m: Optional[Array] = None
                ) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """
        Return the raw pixels of points, left and right, and their validity, left and right.

        :param points_m: (..., 3) points in the left camera's frame, m.
        :param later_m: (..., 3) the same points at the time of the right exposure, m; None if they
            do not move.
        """
        left, in_left = self.left.project(points_m)
        later_m = points_m if later_m is None else later_m
        if self._right.known:
            right, in_right = projected(np.asarray(later_m, dtype=np.float64), self._right)
        else:
            right, in_right = self.right.project(self.to_right(later_m))
        return left, right, in_left, in_right

    @cached_property
    def _right(self) -> Projection:
        """Return the right camera for points in the left camera's frame."""
        return self.right.projection.seen_from(self.R, self.t)

    def epipolar_lines_right(self, uv_left: Array) -> Array:
        """
        Return the epipolar lines of left pixels, in normalised coordinates of the right camera.

        :param uv_left: (..., 2) raw pixels.
        :return: (..., 3) lines ``l`` with ``l . (x, y, 1) = 0``.
        """
        return self.left.rays(uv_left) @ self.essential.T

    def triangulate(self, uv_left: Array, uv_right: Array) -> Array:
        """
        Return the points of pixel pairs; NaN for parallel rays or points behind a camera.

        Both pixels are first moved onto a common epipolar plane by the least squared change
        in normalised coordinates (Lindstrom 2010, two steps), then their rays are intersected.

        :param uv_left: (..., 2) raw pixels.
        :param uv_right: (..., 2) corresponding raw pixels.
        """
        left, right = self._corrected(self.left.rays(uv_left), self.right.rays(uv_right))
        right_in_left = right @ self.R
        centre = -self.R.T @ self.t
        # The depths a, b of the rays' closest points solve a left = centre + b right_in_left.
        ll = np.sum(left * left, axis=-1)
        rr = np.sum(right_in_left * right_in_left, axis=-1)
        lr = np.sum(left * right_in_left, axis=-1)
        lc, rc = left @ centre, right_in_left @ centre
        det = ll * rr - lr * lr
        with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
            a, b = (lc * rr - lr * rc) / det, (lr * lc - ll * rc) / det
            bad = ~((a > 0) & (b > 0) & np.isfinite(a + b) & (det > 1e-16 * ll * rr))
        a, b = (np.where(bad, np.nan, depth)[..., None] for depth in (a, b))
        return 0.5 * (a * left + centre + b * right_in_left)

    def _corrected(self, left: Array, right: Array) -> tuple[Array, Array]:
        """Return rays (..., 3) at depth 1 with least change so that ``right^T E left = 0``."""
        e = self.essential
        e2 = e[:2, :2]
        n_r, n_l = (left @ e.T)[..., :2], (right @ e)[..., :2]
        a = np.sum(n_r * (n_l @ e2.T), axis=-1)
        b = 0.5 * (np.sum(n_r * n_r, axis=-1) + np.sum(n_l * n_l, axis=-1))
        c = np.sum(right * (left @ e.T), axis=-1)
        with np.errstate(divide='ignore', invalid='ignore'):
            d = np.sqrt(np.maximum(b * b - a * c, 0.0))
            step = (c / (b + d))[..., None]
            n_r, n_l = n_r - (step * n_l) @ e2.T, n_l - (step * n_r) @ e2
            squares = np.sum(n_r * n_r, axis=-1) + np.sum(n_l * n_l, axis=-1)
            step = step * (2 * d / squares)[..., None]
        one = np.zeros_like(left[..., :1])
        return (left - np.concatenate([step * n_l, one], axis=-1),
                right - np.concatenate([step * n_r, one], axis=-1))
