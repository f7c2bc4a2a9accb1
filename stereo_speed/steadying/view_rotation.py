# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""How one camera has rotated since an earlier image, by details that stand still."""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from .config import SteadyingConfig
from .details import BORDER_PX, Details, Grey
from ..core.records import Array
from ..estimation.robust import robust_std
from ..geometry.camera import Camera
from ..geometry.rig import of_camera

_BLUR_PX = 5  # of the kernel over the images, so that they can be read between their pixels
_COARSE = 8  # times fewer pixels in the image that the rotation is first sought in
_ITERATIONS = {_COARSE: 10, 1: 10}  # of Gauss-Newton, at most
_SETTLED_PX = 0.03  # a step that moves the image by less is the last
_ROUNDS = 4  # of reweighting in each step
_STEP_RAD = 1e-5  # of the differences by the rotation: 1e-2 px
_KEPT_SHARE = 0.5  # of the images, in which a detail that is kept agreed
_SURE_SHARE = 0.4  # of the details, that agree where the camera is as expected
_LEAST_NOISE = 0.01  # squared grey levels, of patches that are the same
_NORMAL = 1.386  # median of the square of two normal variables of unit variance, summed


@dataclass(frozen=True, eq=False)
class Rotated:
    """
    The rotation of a camera.

    :param angles_rad: (3,) pan, tilt and roll.
    :param covariance_rad2: (3, 3).
    :param details: how many show it.
    :param spread_px: robust r.m.s. of their places about it.
    :param fits: (n,) which details agree with it.
    :param grey: (n, k, k) what the details look like.
    """

    angles_rad: Array
    covariance_rad2: Array
    details: int
    spread_px: float
    fits: NDArray[np.bool_]
    grey: NDArray[np.float32]


class _Level:
    """
    Details of one view in an image of some size, and how the camera's rotation moves them.

    :param camera: the camera.
    :param details: in pixels of that image; those without a ray are left out.
    :param scale: of a pixel of it in those of the camera.
    """

    def __init__(self, camera: Camera, details: Details, scale: int) -> None:
        self.camera, self.scale = camera, scale
        xy = camera.undistort((details.centres_px + 0.5) * scale - 0.5)
        rayed = np.isfinite(xy).all(axis=1)
        self.details = Details(details.centres_px[rayed], details.grey[rayed])
        self.rays = np.concatenate([xy[rayed], np.ones_like(xy[rayed, :1])], axis=-1)

    def places(self, angles_rad: Array) -> Array:
        """Return where the details (n, 2) are after a rotation of the camera."""
        rays = self.rays @ of_camera(angles_rad).T
        uv = self.camera.distort(rays[:, :2] / rays[:, 2:])
        return np.asarray((uv + 0.5) / self.scale - 0.5)

    @cached_property
    def jacobian(self) -> Array:
        """Return how the details move along their axes with pan, tilt and roll, (n, 2, 3)."""
        steps = _STEP_RAD * np.eye(3)
        moved = np.stack([(self.places(s) - self.places(-s)) / (2 * _STEP_RAD) for s in steps],
                         axis=-1)
        return np.asarray(self.details.axes @ moved)


class ViewRotation:
    """
    Follows the rotation of one camera; the first image is what all are compared with.

    :param camera: the camera.
    :param image: (H, W) its first image.
    :param config: parameters.
    """

    def __init__(self, camera: Camera, image: Grey, config: SteadyingConfig) -> None:
        self.camera, self.config = camera, config
        fine, coarse = smooth(image), shrunk(image)
        self._coarse = _Level(camera, Details.of(coarse, config.details), _COARSE)
        self._fine = _Level(camera, Details.of(fine, config.details), 1)
        self._forget()

    def measure(self, image: Grey, about_rad: Array) -> Optional[Rotated]:
        """
        Return the rotation of the camera in another image; None where too little shows it.

        It is unknown, too, where no rotation explains how the details have moved, as in the
        images of a camera that drives.

        :param image: (H, W).
        :param about_rad: (3,) the rotation that it may have.
        """
        found = self._sought(image, about_rad)
        return found if found and found.spread_px <= self.config.most_spread_px else None

    def _sought(self, image: Grey, about_rad: Array) -> Optional[Rotated]:
        """Return the rotation that most details agree on, where there are enough."""
        fine = smooth(image)
        found = self._settled(self._fine, fine, about_rad)
        if found is not None and found.details >= _SURE_SHARE * len(self._fine.details):
            return found
        coarse = shrunk(image)
        for start in (about_rad, np.zeros(3)):
            found = self._settled(self._coarse, coarse, start)
            if found is not None:
                return self._settled(self._fine, fine, found.angles_rad)
        return None

    def learn(self, image: Grey, found: Rotated) -> bool:
        """
        Take in what the details look like in an image; at times, put others in place of the lost.

        :param image: (H, W).
        :param found: the rotation of the camera in it.
        :return: whether later images are compared with other details.
        """
        self._sum[found.fits] += found.grey[found.fits]
        self._seen += found.fits
        self._images += 1
        if self._images < self.config.renew_pairs:
            return False
        kept, old = self._seen >= _KEPT_SHARE * self._images, self._fine.details
        mean = self._sum / np.maximum(self._seen, 1)[:, None, None]
        grey = old.grey + np.float32(self.config.learning_share) * (mean - old.grey)
        # Where the details that are kept are now, no others are sought.
        there = self._fine.places(found.angles_rad)[kept]
        others = self._back(Details.of(smooth(image), self.config.details, there), found, 1)
        self._fine = _Level(self.camera, Details(
            np.concatenate([old.centres_px[kept], others.centres_px]),
            np.concatenate([grey[kept], others.grey])), 1)
        coarse = Details.of(shrunk(image), self.config.details)
        self._coarse = _Level(self.camera, self._back(coarse, found, _COARSE), _COARSE)
        self._forget()
        return True

    def _back(self, details: Details, found: Rotated, scale: int) -> Details:
        """Return details of an image where they would be, had the camera not rotated."""
        uv = (details.centres_px + 0.5) * scale - 0.5
        rays = self.camera.rays(uv) @ of_camera(found.angles_rad)
        uv = self.camera.distort(rays[:, :2] / rays[:, 2:])
        return Details((uv + 0.5) / scale - 0.5, details.grey)

    def _forget(self) -> None:
        """Begin to count anew."""
        details = self._fine.details
        self._sum = np.zeros_like(details.grey)
        self._seen = np.zeros(len(details), dtype=int)
        self._images = 0

    def _settled(self, level: _Level, image: Grey, start_rad: Array) -> Optional[Rotated]:
        """Return the rotation at which the details of a level agree; None for too few."""
        if len(level.details) < self.config.least_details:
            return None
        angles: Array = start_rad
        out: Optional[Rotated] = None
        for _ in range(_ITERATIONS[level.scale]):
            places = level.places(angles)
            out = self._step(level, image, places, angles)
            if out is None:
                return None
            moved = np.abs(level.jacobian @ (out.angles_rad - angles)).max()
            angles = out.angles_rad
            if moved < _SETTLED_PX:
                break
        return out

    def _step(self, level: _Level, image: Grey, places: Array, angles: Array
              ) -> Optional[Rotated]:
        """Return the rotation that the offsets of the details from some places ask for."""
        seen = level.details.find(image, places)
        good = (seen.ncc >= self.config.least_ncc) & _inside(places, image)
        if good.sum() < self.config.least_details:
            return None
        told = level.details.information[good]
        noise = max(float(np.median(seen.noise[good])), _LEAST_NOISE)
        weight = 1 / (noise / told + self.config.detail_floor_px ** 2)  # (n, 2), per px^2
        jacobian, offset = level.jacobian[good], seen.offset_px[good]
        share, limit = np.ones(len(offset)), np.inf
        for left in reversed(range(_ROUNDS)):
            rows = (share[:, None] * weight)[..., None] * jacobian
            normal = np.tensordot(rows, jacobian, ((0, 1), (0, 1)))
            step = np.linalg.solve(normal, np.tensordot(rows, offset, ((0, 1), (0, 1))))
            off = offset - jacobian @ step
            chi2 = (weight * off ** 2).sum(axis=1)
            scale2 = max(float(np.median(chi2)) / _NORMAL, 1.0)
            limit = self.config.outlier_sigmas ** 2 * scale2
            # What moves by itself, as a lamp that a wet road mirrors, has no weight in the last.
            share = 1 / (1 + chi2 / limit) if left > 1 else (chi2 < limit).astype(np.float64)
        fits = np.zeros(len(good), dtype=bool)
        fits[good] = chi2 < limit
        alike = max(float(share.sum()) / self.config.independent_details, 1.0)
        covariance = np.asarray(alike * scale2 * np.linalg.inv(normal), np.float64)
        return Rotated(np.asarray(angles + step, np.float64), covariance, int(fits.sum()),
                       robust_std(off), fits, seen.grey)


def smooth(image: Grey) -> Grey:
    """Return an image that can be read between its pixels."""
    return np.asarray(cv2.GaussianBlur(image, (_BLUR_PX, _BLUR_PX), 0))


def shrunk(image: Grey) -> Grey:
    """Return an image of ``_COARSE`` times fewer rows and columns."""
    height, width = image.shape
    size = width // _COARSE, height // _COARSE
    part = image[:size[1] * _COARSE, :size[0] * _COARSE]
    return smooth(np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA)))


def _inside(places: Array, image: Grey) -> NDArray[np.bool_]:
    last = np.array(image.shape[::-1]) - 1 - BORDER_PX
    return np.asarray(((places >= BORDER_PX) & (places <= last)).all(axis=1))
