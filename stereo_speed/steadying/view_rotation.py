# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The rotation of one camera since an earlier image, estimated from static details."""
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

_BLUR_PX = 5  # size of the smoothing kernel, so that images can be interpolated
_COARSE = 8  # reduction of the image in which the rotation is first searched
_ITERATIONS = {_COARSE: 10, 1: 10}  # most Gauss-Newton steps, by scale
_SETTLED_PX = 0.03  # displacement of the image below which a step is the last one
_ROUNDS = 4  # rounds of reweighting in each step
_STEP_RAD = 1e-5  # step for finite differences by the rotation, about 1e-2 px
_KEPT_SHARE = 0.5  # least share of images in which a detail must agree to be kept
_SURE_SHARE = 0.4  # least share of agreeing details for which the expected rotation is accepted
_LEAST_NOISE = 0.01  # lower bound of the noise variance in squared grey levels
_CHI2_MEDIAN = 1.386  # median of chi-square with two degrees of freedom


@dataclass(frozen=True, eq=False)
class Rotated:
    """
    The measured rotation of a camera.

    :param angles_rad: (3,) pan, tilt and roll, rad.
    :param covariance_rad2: (3, 3) their covariance, rad^2.
    :param details: number of details that agree with it.
    :param spread_px: robust r.m.s. residual of the details, px.
    :param fits: (n,) which details agree with it.
    :param grey: (n, k, k) current grey values of the details.
    """

    angles_rad: Array
    covariance_rad2: Array
    details: int
    spread_px: float
    fits: NDArray[np.bool_]
    grey: NDArray[np.float32]


class _Level:
    """
    Details of one view at one scale, and their motion with the camera's rotation.

    :param camera: the camera.
    :param details: details in pixels of this scale; those without a ray are left out.
    :param scale: size of a pixel of this scale in pixels of the camera.
    """

    def __init__(self, camera: Camera, details: Details, scale: int) -> None:
        self.camera, self.scale = camera, scale
        xy = camera.undistort((details.centres_px + 0.5) * scale - 0.5)
        rayed = np.isfinite(xy).all(axis=1)
        self.details = Details(details.centres_px[rayed], details.grey[rayed])
        self.rays = np.concatenate([xy[rayed], np.ones_like(xy[rayed, :1])], axis=-1)

    def places(self, angles_rad: Array) -> Array:
        """Return where the details are after a rotation of the camera, (n, 2), px."""
        rays = self.rays @ of_camera(angles_rad).T
        uv = self.camera.distort(rays[:, :2] / rays[:, 2:])
        return np.asarray((uv + 0.5) / self.scale - 0.5)

    @cached_property
    def jacobian(self) -> Array:
        """Return the motion (n, 2, 3) of the details along their axes per rad of each angle."""
        steps = _STEP_RAD * np.eye(3)
        moved = np.stack([(self.places(s) - self.places(-s)) / (2 * _STEP_RAD) for s in steps],
                         axis=-1)
        return np.asarray(self.details.axes @ moved)


class ViewRotation:
    """
    Measures the rotation of one camera in images, relative to its first image.

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

    @property
    def has_enough(self) -> bool:
        """Return whether the first image shows enough details for a known rotation."""
        return len(self._fine.details) >= self.config.least_details

    def measure(self, image: Grey, about_rad: Array) -> Optional[Rotated]:
        """
        Return the rotation of the camera in another image; None if it is unknown.

        It is unknown if too few details are visible, or if no rotation explains their motion, as
        in the images of a driving camera.

        :param image: (H, W) the image.
        :param about_rad: (3,) expected rotation, rad.
        """
        found = self._search(image, about_rad)
        return found if found and found.spread_px <= self.config.most_spread_px else None

    def _search(self, image: Grey, about_rad: Array) -> Optional[Rotated]:
        """Return the rotation that most details agree on; None if there are too few."""
        fine = smooth(image)
        found = self._converged(self._fine, fine, about_rad)
        if found is not None and found.details >= _SURE_SHARE * len(self._fine.details):
            return found
        coarse = shrunk(image)
        for start in (about_rad, np.zeros(3)):
            found = self._converged(self._coarse, coarse, start)
            if found is not None:
                return self._converged(self._fine, fine, found.angles_rad)
        return None

    def learn(self, image: Grey, found: Rotated) -> bool:
        """
        Learn the appearance of the details in an image; from time to time, replace lost details.

        :param image: (H, W) the image.
        :param found: rotation of the camera in it.
        :return: whether later images will be compared with other details.
        """
        self._sum[found.fits] += found.grey[found.fits]
        self._seen += found.fits
        self._images += 1
        if self._images < self.config.renew_pairs:
            return False
        kept, old = self._seen >= _KEPT_SHARE * self._images, self._fine.details
        mean = self._sum / np.maximum(self._seen, 1)[:, None, None]
        grey = old.grey + np.float32(self.config.learning_share) * (mean - old.grey)
        # New details must not overlap the places where the kept ones are now.
        current_px = self._fine.places(found.angles_rad)[kept]
        fresh = self._moved_back(
            Details.of(smooth(image), self.config.details, current_px), found, 1)
        self._fine = _Level(self.camera, Details(
            np.concatenate([old.centres_px[kept], fresh.centres_px]),
            np.concatenate([grey[kept], fresh.grey])), 1)
        coarse = Details.of(shrunk(image), self.config.details)
        self._coarse = _Level(self.camera, self._moved_back(coarse, found, _COARSE), _COARSE)
        self._forget()
        return True

    def _moved_back(self, details: Details, found: Rotated, scale: int) -> Details:
        """Return details of an image moved to where they were before the camera rotated."""
        uv = (details.centres_px + 0.5) * scale - 0.5
        rays = self.camera.rays(uv) @ of_camera(found.angles_rad)
        uv = self.camera.distort(rays[:, :2] / rays[:, 2:])
        return Details((uv + 0.5) / scale - 0.5, details.grey)

    def _forget(self) -> None:
        """Reset the statistics of the details."""
        details = self._fine.details
        self._sum = np.zeros_like(details.grey)
        self._seen = np.zeros(len(details), dtype=int)
        self._images = 0

    def _converged(self, level: _Level, image: Grey, start_rad: Array) -> Optional[Rotated]:
        """Return the converged rotation by the details of a level; None if there are too few."""
        if len(level.details) < self.config.least_details:
            return None
        angles: Array = start_rad
        out: Optional[Rotated] = None
        for _ in range(_ITERATIONS[level.scale]):
            places = level.places(angles)
            out = self._iteration(level, image, places, angles)
            if out is None:
                return None
            moved = np.abs(level.jacobian @ (out.angles_rad - angles)).max()
            angles = out.angles_rad
            if moved < _SETTLED_PX:
                break
        return out

    def _iteration(self, level: _Level, image: Grey, places: Array, angles: Array
                   ) -> Optional[Rotated]:
        """Return the rotation after one step, from the offsets of the details; None as above."""
        seen = level.details.find(image, places)
        good = (seen.ncc >= self.config.least_ncc) & _inside(places, image)
        if good.sum() < self.config.least_details:
            return None
        information = level.details.information[good]
        noise = max(float(np.median(seen.noise[good])), _LEAST_NOISE)
        weight = 1 / (noise / information + self.config.detail_floor_px ** 2)  # (n, 2), per px^2
        jacobian, offset = level.jacobian[good], seen.offset_px[good]
        share, limit = np.ones(len(offset)), np.inf
        for remaining in reversed(range(_ROUNDS)):
            rows = (share[:, None] * weight)[..., None] * jacobian
            normal = np.tensordot(rows, jacobian, ((0, 1), (0, 1)))
            step = np.linalg.solve(normal, np.tensordot(rows, offset, ((0, 1), (0, 1))))
            residual = offset - jacobian @ step
            chi2 = (weight * residual ** 2).sum(axis=1)
            scale2 = max(float(np.median(chi2)) / _CHI2_MEDIAN, 1.0)
            limit = self.config.outlier_sigmas ** 2 * scale2
            # In the last rounds, moving details such as reflected headlamps have no weight at all.
            share = 1 / (1 + chi2 / limit) if remaining > 1 else (chi2 < limit).astype(np.float64)
        fits = np.zeros(len(good), dtype=bool)
        fits[good] = chi2 < limit
        redundancy = max(float(share.sum()) / self.config.independent_details, 1.0)
        covariance = np.asarray(redundancy * scale2 * np.linalg.inv(normal), np.float64)
        return Rotated(np.asarray(angles + step, np.float64), covariance, int(fits.sum()),
                       robust_std(residual), fits, seen.grey)


def smooth(image: Grey) -> Grey:
    """Return a smoothed image that can be interpolated."""
    return np.asarray(cv2.GaussianBlur(image, (_BLUR_PX, _BLUR_PX), 0))


def shrunk(image: Grey) -> Grey:
    """Return a smoothed image with ``_COARSE`` times fewer rows and columns."""
    height, width = image.shape
    size = width // _COARSE, height // _COARSE
    part = image[:size[1] * _COARSE, :size[0] * _COARSE]
    return smooth(np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA)))


def _inside(places: Array, image: Grey) -> NDArray[np.bool_]:
    last = np.array(image.shape[::-1]) - 1 - BORDER_PX
    return np.asarray(((places >= BORDER_PX) & (places <= last)).all(axis=1))
