# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The speed profile of a whole pass.

The states of filtering trackers are smoothed backwards in time.  Trackers that only triangulate
have positions alone: the speeds between them are fitted by a polynomial in time, by generalised
least squares.  Polynomial degrees are averaged by the Bayesian information criterion (G. Schwarz,
Annals of Statistics 6(2), 1978), so that the fit follows braking but not noise.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np

from .constant_velocity import Gaussian, smooth, Transition
from ...core.records import Array
from ...estimation.weights import normalise_log_weights

_DEGREES = (0, 1, 2)  # degrees of the averaged polynomials


@dataclass(frozen=True, eq=False)
class Profile:
    """
    Speeds over a pass.

    :param speed_mps: (n,), speeds.
    :param std_mps: (n,), their 1-sigmas.
    :param mean_std_mps: 1-sigma of their mean.
    """

    speed_mps: Array
    std_mps: Array
    mean_std_mps: float


def smoothed_profile(filtered: Sequence[Gaussian], steps: Sequence[Transition],
                     seen: Sequence[bool]) -> Profile:
    """
    Return the smoothed speeds of a filtered pass with states (p, v).

    :param filtered: the beliefs of all pairs.
    :param steps: the transitions between them.
    :param seen: mask of the pairs in which the vehicle was seen; the others only bridge gaps.
    """
    means, joint = smooth(filtered, steps)
    at = np.flatnonzero(seen)
    return _profile(means[at, 3:], joint[np.ix_(at, at)][:, :, 3:, 3:])


def fitted_profile(times_s: Array, positions_m: Array, covs: Array) -> Profile:
    """
    Return the speeds of a polynomial in time, fitted to those between positions.

    Neighbouring speeds share a position, so their errors are correlated: their covariance is
    D V D^T, with V the variances of the positions along the motion and D the difference operator.

    :param times_s: (n,), n >= 2.
    :param positions_m: (n, 3).
    :param covs: (n, 3, 3) of the positions.
    """
    dt, steps = np.diff(times_s), np.diff(positions_m, axis=0)
    along = _directions(times_s, positions_m)
    # The length of a noisy step is biased; its component along the motion is not.
    travel = np.sum(steps * 0.5 * (along[1:] + along[:-1]), axis=1)
    differences = np.diff(np.eye(len(times_s)), axis=0) / dt[:, None]
    variance = np.einsum('ni,nij,nj->n', along, covs, along)
    noise = differences @ np.diag(variance) @ differences.T
    span = max(float(np.ptp(times_s)), 1e-9)
    t = (times_s - times_s.mean()) / span
    middle = 0.5 * (t[1:] + t[:-1])
    speeds = travel / dt
    fits = [_fit(middle, speeds, noise, degree) for degree in _DEGREES if degree < len(speeds)]
    criteria = np.array([fit[2] for fit in fits])
    share = normalise_log_weights(-0.5 * criteria)
    designs = [np.vander(t, len(x), increasing=True) for x, _, _ in fits]
    fitted = np.array([design @ x for design, (x, _, _) in zip(designs, fits)])
    mean = share @ fitted
    joint = sum(w * (design @ cov @ design.T + np.outer(speed - mean, speed - mean))
                for w, design, speed, (_, cov, _) in zip(share, designs, fitted, fits))
    return Profile(mean, np.sqrt(np.diag(joint)), float(np.sqrt(joint.mean())))


def _directions(times_s: Array, positions_m: Array) -> Array:
    """Return the directions (n, 3) of the motion, from a parabola through the positions."""
    t = times_s - times_s.mean()
    design = np.vander(t, min(len(t), _DEGREES[-1] + 1), increasing=True)
    x = np.linalg.lstsq(design, positions_m, rcond=None)[0]
    slopes = np.stack([k * t ** (k - 1) for k in range(1, len(x))], axis=1) @ x[1:]
    return np.asarray(slopes / np.maximum(np.linalg.norm(slopes, axis=1), 1e-9)[:, None])


def _fit(t: Array, values: Array, noise: Array, degree: int) -> tuple[Array, Array, float]:
    """
    Fit one polynomial by generalised least squares.

    :param noise: (n, n), covariance of the values.
    :return: coefficients, their covariance and the information criterion.
    """
    white = np.linalg.inv(np.linalg.cholesky(noise))
    design, wanted = white @ np.vander(t, degree + 1, increasing=True), white @ values
    cov = np.linalg.inv(design.T @ design)
    x = cov @ (design.T @ wanted)
    rest = float(np.sum(np.square(wanted - design @ x)))
    # Errors larger than their covariance show in the residual.
    inflation = max(rest / max(len(t) - len(x), 1), 1.0)
    return x, np.asarray(cov * inflation, np.float64), rest + len(x) * float(np.log(len(t)))


def _profile(velocity: Array, joint: Array) -> Profile:
    """
    Return the speeds of velocities.

    :param velocity: (n, 3), velocities.
    :param joint: (n, n, 3, 3), their joint covariance.
    """
    speed = np.linalg.norm(velocity, axis=1)
    along = velocity / np.maximum(speed, 1e-9)[:, None]
    cov = np.einsum('ai,abij,bj->ab', along, joint, along)
    n = len(speed)
    return Profile(speed, np.sqrt(np.maximum(np.diag(cov), 0.0)),
                   float(np.sqrt(max(float(cov.sum()), 0.0)) / n))
