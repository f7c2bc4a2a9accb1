# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Kalman filter and smoother of a point that moves at constant velocity.

The state is (p, v), position and velocity in m and m/s.  The velocity is a Wiener process: over
dt with rate matrix q its covariance grows by [[q dt^3/3, q dt^2/2], [q dt^2/2, q dt]]
(Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and
Navigation", 2001, Section 6.2.2).  The rates along and across the velocity differ, as vehicles
turn more sharply than they brake ("directional process noise").  Whole passes are smoothed by the
backward recursion of H. E. Rauch, F. Tung, C. T. Striebel, AIAA Journal 3(8), 1965.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np

from ...core.records import Array

_JITTER = 1e-12  # keeps a covariance without process noise invertible


@dataclass(frozen=True, eq=False)
class Gaussian:
    """
    A Gaussian belief.

    :param mean: (n,), mean.
    :param cov: (n, n), covariance.
    """

    mean: Array
    cov: Array


@dataclass(frozen=True, eq=False)
class Transition:
    """
    A linear transition x' = F x + noise of covariance Q.

    :param F: (n, n), transition matrix.
    :param Q: (n, n), covariance of the process noise.
    """

    F: Array
    Q: Array


def transition(dt_s: float, rate: Array) -> Transition:
    """
    Return the transition of position and velocity over ``dt_s``.

    :param rate: (3, 3), q, growth of the velocity's covariance per second, m^2/s^3.
    """
    eye, zero = np.eye(3), np.zeros((3, 3))
    return Transition(
        np.block([[eye, dt_s * eye], [zero, eye]]),
        np.block([[rate * dt_s ** 3 / 3, rate * dt_s ** 2 / 2],
                  [rate * dt_s ** 2 / 2, rate * dt_s]]))


def directional_rate(direction: Array, up: Array, along: float, across: float,
                     climb: float) -> Array:
    """
    Return the rate matrix q of standard deviations along, across and above the motion.

    :param direction: (3,), direction of the velocity, of any length but 0.
    :param up: (3,), approximate up direction.
    :param along: standard deviation along the motion, m/s/sqrt(s).
    :param across: standard deviation across the motion, m/s/sqrt(s).
    :param climb: vertical standard deviation, m/s/sqrt(s).
    """
    t = direction / np.linalg.norm(direction)
    p = np.cross(up, t)
    p = p / np.linalg.norm(p)
    basis = np.column_stack([t, p, np.cross(t, p)])
    return np.asarray(basis @ np.diag(np.square([along, across, climb])) @ basis.T)


def predict(belief: Gaussian, step: Transition) -> Gaussian:
    """Return a belief after a transition: (F m, F P F' + Q)."""
    return Gaussian(step.F @ belief.mean, step.F @ belief.cov @ step.F.T + step.Q)


def correct(belief: Gaussian, measured: Array, noise: Array) -> Gaussian:
    """
    Return a belief updated by a measurement of its first unknowns, in Joseph's form.

    :param measured: (m,), the measurement.
    :param noise: (m, m), covariance of the measurement.
    """
    m, n = len(measured), len(belief.mean)
    innovation = belief.cov[:m, :m] + noise
    gain = np.linalg.solve(innovation, belief.cov[:m]).T
    keep = np.eye(n)
    keep[:, :m] -= gain
    return Gaussian(belief.mean + gain @ (measured - belief.mean[:m]),
                    keep @ belief.cov @ keep.T + gain @ noise @ gain.T)


def distance2(belief: Gaussian, measured: Array, noise: Array) -> float:
    """Return the squared Mahalanobis distance of a measurement (see above) from a belief."""
    m = len(measured)
    off = measured - belief.mean[:m]
    return float(off @ np.linalg.solve(belief.cov[:m, :m] + noise, off))


def smooth(filtered: Sequence[Gaussian], steps: Sequence[Transition]
           ) -> tuple[Array, Array]:
    """
    Return the states of a pass given all its measurements (Rauch, Tung and Striebel 1965).

    :param filtered: k beliefs, each from the measurements so far.
    :param steps: the k - 1 transitions between them.
    :return: (k, n) means and (k, k, n, n) their joint covariance.
    """
    k, n = len(filtered), len(filtered[0].mean)
    means, joint = np.zeros((k, n)), np.zeros((k, k, n, n))
    means[-1], joint[-1, -1] = filtered[-1].mean, filtered[-1].cov
    for i in range(k - 2, -1, -1):
        ahead = predict(filtered[i], steps[i])
        cov = ahead.cov + _JITTER * np.eye(n)
        gain = np.linalg.solve(cov, steps[i].F @ filtered[i].cov).T
        means[i] = filtered[i].mean + gain @ (means[i + 1] - ahead.mean)
        joint[i, i] = filtered[i].cov + gain @ (joint[i + 1, i + 1] - ahead.cov) @ gain.T
        joint[i, i + 1:] = gain @ joint[i + 1, i + 1:]  # Cov(x_i, x_j) = G_i Cov(x_i+1, x_j)
        joint[i + 1:, i] = np.swapaxes(joint[i, i + 1:], 1, 2)
    return means, joint
