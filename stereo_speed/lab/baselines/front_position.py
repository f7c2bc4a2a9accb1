# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Position and displacement of a front from its triangulated points.

Points appear and disappear between pairs, so their centroid jumps.  The front is modelled as a
plane across the motion (2012, Section III-A) with normal n: each point gives n.X, the robust mean
of these is the plane's distance d, and the front's centre is where the ray of its centre meets
that plane.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from .matthies_shafer import covariances
from .settings import PointSettings
from ...core.records import Array
from ...geometry.rig import StereoRig


@dataclass(frozen=True, eq=False)
class Measurement:
    """
    A measured position or displacement, m.

    :param mean: (3,), measured value.
    :param cov: (3, 3), its covariance.
    :param used: (n,), mask of the points that agree.
    """

    mean: Array
    cov: Array
    used: NDArray[np.bool_]


def agreeing(values: Array, stds: Array, outlier_sigmas: float
             ) -> tuple[NDArray[np.bool_], float]:
    """
    Return a mask of the values near their median.

    :param values: (n,), the values.
    :param stds: (n,), their expected 1-sigmas.
    :param outlier_sigmas: robust standard deviations beyond which a value does not agree.
    :return: mask (n,), and the ratio of actual to expected scatter, at least 1.
    """
    ratio = (values - np.median(values)) / stds
    scale = max(1.0, float(median_abs_deviation(ratio, scale='normal')))
    return np.abs(ratio) < outlier_sigmas * scale, scale


def position_of_front(rig: StereoRig, points_m: Array, centre_px: Array, normal: Array,
                      settings: PointSettings) -> Optional[Measurement]:
    """
    Return the position of a front's centre; None when too few points agree.

    :param points_m: (n, 3) triangulated points of the front.
    :param centre_px: (2,) its centre in the raw left view.
    :param normal: (3,) unit normal of its plane.
    :param settings: errors of the points, and how many must agree.
    """
    if len(points_m) < settings.least_points:
        return None
    covs = covariances(rig, points_m, settings.match_std_px)
    var = np.einsum('i,nij,j->n', normal, covs, normal)
    along = points_m @ normal
    used, scale = agreeing(along, np.sqrt(var), settings.outlier_sigmas)
    if used.sum() < settings.least_points:
        return None
    weight = used / var
    d = float(weight @ along / weight.sum())
    common = (settings.common_std_px / settings.match_std_px) ** 2 * float(np.median(var))
    ray = rig.left.rays(centre_px)
    slant = float(ray @ normal)
    mean = ray * d / slant
    by_d = ray / slant
    by_ray = d / slant * (np.eye(3) - np.outer(ray, normal) / slant)
    spread = settings.centre_std_px * np.array(
        [1 / rig.left.K[0, 0], 1 / rig.left.K[1, 1], 0.0])
    cov = (scale ** 2 / weight.sum() + common) * np.outer(by_d, by_d) \
        + by_ray @ np.diag(spread ** 2) @ by_ray.T
    return Measurement(mean, cov, used)


def displacement(rig: StereoRig, before_m: Array, after_m: Array, normal: Array,
                 settings: PointSettings) -> Optional[Measurement]:
    """
    Return the mean displacement of the points that agree; None when too few do.

    :param before_m: (n, 3), positions before.
    :param after_m: (n, 3), positions of the same points after.
    :param normal: (3,), direction in which agreement is checked: that of the depth errors.
    :param settings: errors of the points, and how many must agree.
    """
    if len(before_m) < settings.least_points:
        return None
    covs = covariances(rig, before_m, settings.match_std_px) \
        + covariances(rig, after_m, settings.match_std_px)
    motion = after_m - before_m
    var = np.einsum('i,nij,j->n', normal, covs, normal)
    used, scale = agreeing(motion @ normal, np.sqrt(var), settings.outlier_sigmas)
    if used.sum() < settings.least_points:
        return None
    information = np.linalg.inv(covs[used])
    cov = np.linalg.inv(information.sum(axis=0))
    mean = cov @ np.einsum('nij,nj->i', information, motion[used])
    common = (settings.common_std_px / settings.match_std_px) ** 2 * np.median(covs[used], axis=0)
    return Measurement(mean, scale ** 2 * cov + common, used)
