# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Read cameras and the stereo rig from ``sensor_msgs/CameraInfo`` messages.

The messages are duck-typed: ROS 1 names the matrices D, K, R, P, ROS 2 names them d, k, r, p.
"""
from __future__ import annotations

from typing import Any

import numpy as np

from ..core.errors import CalibrationError
from ..core.records import Array
from ..geometry.camera import Camera
from ..geometry.rig import StereoRig


_OWN_CENTRE_M = 1e-6  # distance of a camera from where it should be, m, due to rounding
_LARGEST = 1e9  # larger numbers would soon overflow in squares and products


def _numbers(msg: Any, field: str, where: object) -> Array:
    """Read a matrix as a flat (n,) float array; its field is in lower or upper case."""
    values = getattr(msg, field.lower(), None)
    if values is None:
        values = getattr(msg, field, None)
    if values is None:
        raise CalibrationError(where, f'CameraInfo {field}', 'no such field',
                               'a CameraInfo message')
    flat = np.asarray(values, dtype=float).reshape(-1)
    if not np.all(np.abs(flat) <= _LARGEST):
        raise CalibrationError(where, f'CameraInfo {field}', flat.tolist(),
                               f'finite numbers up to {_LARGEST:g}')
    return flat


def _matrix(msg: Any, field: str, shape: tuple[int, int], where: object) -> Array:
    flat = _numbers(msg, field, where)
    if flat.size != shape[0] * shape[1]:
        raise CalibrationError(where, f'CameraInfo {field}', f'{flat.size} numbers',
                               f'{shape[0] * shape[1]} numbers')
    return flat.reshape(shape)


def camera_from_info(msg: Any, name: str, where: object) -> Camera:
    """
    Read one camera: the raw image's K and D.

    :param msg: a ``CameraInfo`` message.
    :param name: name of the camera, ``left`` or ``right``.
    :param where: file and topic, for the error.
    :raises CalibrationError: not calibrated (K of zeros), an unknown model, or bad numbers.
    """
    k_px = _matrix(msg, 'K', (3, 3), where)
    if k_px[0, 0] == 0 or k_px[1, 1] == 0:
        raise CalibrationError(where, 'CameraInfo K', f'focal lengths {k_px[0, 0]:g} and '
                               f'{k_px[1, 1]:g} px (not calibrated)', 'focal lengths > 0')
    d = _numbers(msg, 'D', where)
    try:
        return Camera(name=name, width_px=int(msg.width), height_px=int(msg.height), K=k_px,
                      D=d, model=str(msg.distortion_model))
    except CalibrationError as error:
        raise CalibrationError(
            where, f'CameraInfo {error.what}', error.found, error.wanted) from None


def _rotation(msg: Any, where: object) -> Array:
    rotation = _matrix(msg, 'R', (3, 3), where)
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if off > 1e-3 or np.linalg.det(rotation) < 0:
        raise CalibrationError(where, 'CameraInfo R', rotation.reshape(-1).tolist(),
                               'a rotation matrix (rectification)')
    # the digits of a file are not an exact rotation, so the nearest one is taken
    u, _, vt = np.linalg.svd(rotation)
    return np.asarray(u @ vt)


def rig_from_info(left_msg: Any, right_msg: Any, where: object) -> StereoRig:
    """
    Read the rig from the rectification of both cameras.

    ``x_right = R x_left + t`` with ``R = R2ᵀ R1`` and ``t = R2ᵀ [P2[0,3] / P2[0,0], 0, 0]ᵀ``.

    :param left_msg: ``CameraInfo`` of the left camera.
    :param right_msg: ``CameraInfo`` of the right camera.
    :param where: file, for the error.
    :raises CalibrationError: a calibration that cannot be used; a baseline that is not > 0.
    """
    at_left, at_right = f'{where}: left', f'{where}: right'
    left = camera_from_info(left_msg, 'left', at_left)
    right = camera_from_info(right_msg, 'right', at_right)
    r1, r2 = _rotation(left_msg, at_left), _rotation(right_msg, at_right)
    p1 = _matrix(left_msg, 'P', (3, 4), at_left)
    for number, far in ((3, p1[0, 3]), (7, p1[1, 3])):
        if abs(far) > _OWN_CENTRE_M * max(abs(p1[0, 0]), 1.0):
            raise CalibrationError(at_left, f'CameraInfo P[{number}]', far,
                                   '0 (the baseline is measured from the left camera)')
    p2 = _matrix(right_msg, 'P', (3, 4), at_right)
    if p2[0, 0] <= 0:
        raise CalibrationError(at_right, 'CameraInfo P[0]', p2[0, 0], 'a focal length > 0')
    tx = p2[0, 3] / p2[0, 0]
    if -tx <= 0:
        raise CalibrationError(at_right, 'baseline -P[3]/P[0]', f'{0.0 - tx:g} m',
                               '> 0 m (are left and right swapped?)')
    if abs(p2[1, 3] / p2[0, 0]) > _OWN_CENTRE_M:
        raise CalibrationError(at_right, 'CameraInfo P[7]', p2[1, 3],
                               '0 (cameras side by side)')
    return StereoRig(left=left, right=right, R=r2.T @ r1, t=r2.T @ np.array([tx, 0.0, 0.0]),
                     frame_id=str(left_msg.header.frame_id))


def same_calibration(first: Any, second: Any) -> bool:
    """Return whether two ``CameraInfo`` messages hold the same calibration."""
    names = [n for f in 'DKRP' for n in (f, f.lower()) if hasattr(first, n)]
    return all(np.array_equal(getattr(first, n), getattr(second, n)) for n in names) and all(
        getattr(first, n) == getattr(second, n)
        for n in ('width', 'height', 'distortion_model'))


def check_image_size(camera: Camera, image: Any, where: object) -> None:
    """
    Refuse an image whose size is not the calibration's.

    :param camera: the camera that took it.
    :param image: (H, W) array.
    :param where: file and topic, for the error.
    """
    height, width = image.shape[:2]
    if (width, height) != (camera.width_px, camera.height_px):
        raise CalibrationError(where, 'image size', f'{width}x{height} px',
                               f"{camera.width_px}x{camera.height_px} px, the calibration's")
