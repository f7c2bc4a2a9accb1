# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
From triangulated points on a front to the place of the front, and to its displacement.

Points come and go from pair to pair, so their bare centroid jumps.  The front is a plane across
the motion (2012, Section III-A) of normal n: each point gives n.X, their robust mean is the
plane's distance d, and the front's centre is where the ray of its centre meets that plane.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from .matthies_shafer import covariances
from ...core.records import Array
from ...geometry.rig import StereoRig

LEAST_POINTS = 3
_OUTLIER = 3.0  # robust standard deviations
_COMMON_PX = 0.05  # matching error that all points of a pair share, each view
_CENTRE_PX = 0.3  # how well the centre is carried from pair to pair


@dataclass(frozen=True, eq=False)
class Place:
    """
    A measured place or way, m.

    :param mean: (3,).
    :param cov: (3, 3).
    :param used: (n,) which points agreed.
    """

    mean: Array
    cov: Array
    used: NDArray[np.bool_]


def agreeing(values: Array, stds: Array) -> tuple[NDArray[np.bool_], float]:
    """
    Find the values near their median.

    :param values: (n,).
    :param stds: (n,) as expected.
    :return: (n,) which, and by how much more they scatter than expected, at least 1.
    """
    ratio = (values - np.median(values)) / stds
    scale = max(1.0, float(median_abs_deviation(ratio, scale='normal')))
    return np.abs(ratio) < _OUTLIER * scale, scale


def place_of_front(rig: StereoRig, points_m: Array, centre_px: Array, normal: Array,
                   std_px: float) -> Optional[Place]:
    """
    Place a front's centre.

    :param points_m: (n, 3) triangulated points of the front.
    :param centre_px: (2,) its centre in the raw left view.
    :param normal: (3,) unit normal of its plane.
    :param std_px: matching error of each point in each view.
    :return: None when fewer than three points agree.
    """
    if len(points_m) < LEAST_POINTS:
        return None
    covs = covariances(rig, points_m, std_px)
    var = np.einsum('i,nij,j->n', normal, covs, normal)
    along = points_m @ normal
    used, scale = agreeing(along, np.sqrt(var))
    if used.sum() < LEAST_POINTS:
        return None
    weight = used / var
    d = float(weight @ along / weight.sum())
    common = (_COMMON_PX / std_px) ** 2 * float(np.median(var))
    ray = rig.left.rays(centre_px)
    slant = float(ray @ normal)
    mean = ray * d / slant
    by_d = ray / slant
    by_ray = d / slant * (np.eye(3) - np.outer(ray, normal) / slant)
    spread = _CENTRE_PX * np.array([1 / rig.left.K[0, 0], 1 / rig.left.K[1, 1], 0.0])
    cov = (scale ** 2 / weight.sum() + common) * np.outer(by_d, by_d) \
        + by_ray @ np.diag(spread ** 2) @ by_ray.T
    return Place(mean, cov, used)


def displacement(rig: StereoRig, before_m: Array, after_m: Array, normal: Array,
                 std_px: float) -> Optional[Place]:
    """
    Measure how far the same points moved: the mean over those that agree.

    :param before_m: (n, 3).
    :param after_m: (n, 3), point by point.
    :param normal: (3,) direction in which agreement is judged: that of the depth errors.
    :param std_px: matching error of each point in each view.
    :return: None when fewer than three points agree.
    """
    if len(before_m) < LEAST_POINTS:
        return None
    covs = covariances(rig, before_m, std_px) + covariances(rig, after_m, std_px)
    way = after_m - before_m
    var = np.einsum('i,nij,j->n', normal, covs, normal)
    used, scale = agreeing(way @ normal, np.sqrt(var))
    if used.sum() < LEAST_POINTS:
        return None
    information = np.linalg.inv(covs[used])
    cov = np.linalg.inv(information.sum(axis=0))
    mean = cov @ np.einsum('nij,nj->i', information, way[used])
    common = (_COMMON_PX / std_px) ** 2 * np.median(covs[used], axis=0)
    return Place(mean, scale ** 2 * cov + common, used)
