# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The speed profile of a whole pass.

Trackers that filter are smoothed backwards in time.  What only triangulates has positions and
nothing else: a polynomial of the time goes through them by generalised least squares, of the
degree that the Bayesian information criterion chooses (G. Schwarz, Annals of Statistics 6(2),
1978), so that bends and braking fit and noise does not.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np

from .constant_velocity import Gaussian, smooth, Transition
from ..records import Array

_DEGREES = (1, 2, 3)


@dataclass(frozen=True, eq=False)
class Profile:
    """
    Speeds over a pass.

    :param speed_mps: (n,).
    :param std_mps: (n,) their 1-sigma.
    :param mean_std_mps: 1-sigma of their mean.
    """

    speed_mps: Array
    std_mps: Array
    mean_std_mps: float


def smoothed_profile(filtered: Sequence[Gaussian], steps: Sequence[Transition],
                     seen: Sequence[bool]) -> Profile:
    """
    Smooth a filtered pass of states (p, v).

    :param filtered: the beliefs of all pairs.
    :param steps: those between them.
    :param seen: in which pairs the vehicle was seen; the others bridge gaps only.
    """
    means, joint = smooth(filtered, steps)
    at = np.flatnonzero(seen)
    return _profile(means[at, 3:], joint[np.ix_(at, at)][:, :, 3:, 3:])


def fitted_profile(times_s: Array, places_m: Array, covs: Array) -> Profile:
    """
    Fit a polynomial through positions.

    :param times_s: (n,), n >= 2.
    :param places_m: (n, 3).
    :param covs: (n, 3, 3) of the positions.
    """
    span = max(float(np.ptp(times_s)), 1e-9)
    t = (times_s - times_s.mean()) / span
    white = np.linalg.inv(np.linalg.cholesky(covs))
    n, best = len(t), (np.inf, np.zeros(0), np.zeros((0, 0)), 1)
    for degree in (d for d in _DEGREES if d < n):
        rows = np.einsum('nij,nk->nikj', white, np.vander(t, degree + 1, increasing=True))
        design = rows.reshape(3 * n, 3 * (degree + 1))  # unknowns: (power, axis)
        wanted = np.einsum('nij,nj->ni', white, places_m).reshape(-1)
        cov = np.linalg.inv(design.T @ design)
        x = cov @ (design.T @ wanted)
        left = wanted - design @ x
        score = float(left @ left) + len(x) * np.log(3 * n)
        # Errors larger than told show in the residuals.
        inflation = max(float(left @ left) / max(3 * n - len(x), 1), 1.0)
        if score < best[0]:
            best = score, x, cov * inflation, degree
    _, x, cov, degree = best
    powers = np.arange(1, degree + 1)
    slope = np.column_stack([0 * t, powers * t[:, None] ** (powers - 1)]) / span
    rate = np.einsum('nk,ij->nikj', slope, np.eye(3)).reshape(n, 3, -1)
    velocity = rate @ x
    joint = np.einsum('aip,pq,bjq->abij', rate, cov, rate)
    return _profile(velocity, joint)


def _profile(velocity: Array, joint: Array) -> Profile:
    """
    Turn velocities into speeds.

    :param velocity: (n, 3).
    :param joint: (n, n, 3, 3) their joint covariance.
    """
    speed = np.linalg.norm(velocity, axis=1)
    along = velocity / np.maximum(speed, 1e-9)[:, None]
    cov = np.einsum('ai,abij,bj->ab', along, joint, along)
    n = len(speed)
    return Profile(speed, np.sqrt(np.maximum(np.diag(cov), 0.0)),
                   float(np.sqrt(max(float(cov.sum()), 0.0)) / n))
