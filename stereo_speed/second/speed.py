# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Speed from places at uneven times, by a Gaussian process.

The place of a body is a straight line in time plus twice integrated white noise of its
acceleration (C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning", 2006,
sections 2.7 and 6.3.1).  The rate of that noise is marginalised over a grid, by the evidence.
"""
from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..core.records import Array

RATES = (0.02, 0.1, 0.3, 1.0, 3.0)  # rates of the random walk of the speed, m/s/sqrt(s)


def speeds_at(times_s: Array, places_m: Array, covariance: Array, wanted_s: Array
              ) -> tuple[Array, Array]:
    """
    Return speeds (m,) at given times, m/s, and their covariance (m, m).

    :param times_s: (n,) times of the places, rising, n >= 2, s.
    :param places_m: (n,) places along the path, m.
    :param covariance: (n, n) their covariance, m^2.
    :param wanted_s: (m,) times of the speeds, s.
    """
    first = min(float(times_s[0]), float(wanted_s.min()))
    solved = [_solved(times_s - first, places_m, covariance, wanted_s - first, rate ** 2)
              for rate in RATES]
    logs = np.array([log for log, _, _ in solved])
    shares = np.exp(logs - logs.max())
    shares /= shares.sum()
    mean = sum((share * speed for share, (_, speed, _) in zip(shares, solved)),
               np.zeros(len(wanted_s)))
    spread = np.zeros((len(wanted_s), len(wanted_s)))
    for share, (_, speed, inner) in zip(shares, solved):
        spread += share * (inner + np.outer(speed - mean, speed - mean))
    return mean, spread


def _solved(t: Array, places: Array, noise: Array, at: Array, variance: float
            ) -> tuple[float, Array, Array]:
    """
    Return log evidence, speeds and their covariance for one rate.

    :param t: (n,) times of the places since the start of the process, s.
    :param places: (n,) places, m.
    :param noise: (n, n) their covariance, m^2.
    :param at: (m,) times of the speeds since the start of the process, s.
    :param variance: spectral density of the white acceleration, m^2/s^3.
    """
    near, far = np.minimum.outer(t, t), np.maximum.outer(t, t)
    joint = cho_factor(noise + variance * near ** 2 * (3 * far - near) / 6)
    basis = np.column_stack([np.ones(len(t)), t])
    weighed = cho_solve(joint, basis)
    inner = np.linalg.inv(basis.T @ weighed)
    line = inner @ (weighed.T @ places)
    residual = places - basis @ line
    early = np.minimum.outer(at, t)
    slope = variance * (early * t[None] - early ** 2 / 2)  # cov(speed at, place t)
    gain = cho_solve(joint, slope.T).T
    speed = line[1] + gain @ residual
    mean_part = np.array([0.0, 1.0]) - gain @ basis
    covariance = (variance * np.minimum.outer(at, at) - gain @ slope.T
                  + mean_part @ inner @ mean_part.T)
    log = -(np.log(np.diag(joint[0])).sum() - 0.5 * np.linalg.slogdet(inner)[1]
            + 0.5 * float(residual @ cho_solve(joint, residual)))
    return float(log), speed, covariance
