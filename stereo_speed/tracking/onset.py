# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Vehicles that keep their speed until they brake or accelerate.

A driver brakes at once, and the newest pairs show little of it: in a tenth of a second at 6 m/s^2
a vehicle falls behind by 3 cm and loses 1.3 mph.  So any pair may be the last before the speed
begins to change, and the acceleration from then on is one more unknown, constant and eliminated.
It enters only the random walk of the speeds, in which it telescopes, so that each onset follows
from the answer without any in closed form.
"""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Union

import numpy as np

from .motion_prior import Indices
from ..core.records import Array
from ..estimation.gaussian import Conditioned


@dataclass(frozen=True, eq=False)
class Moments:
    """
    Moments of a mixture of Gaussians.

    :param mean: of the unknowns.
    :param covariance: of them.
    :param log_evidence: of all its members together.
    """

    mean: Array
    covariance: Array
    log_evidence: float


def with_onsets(steady: Union[Conditioned, Moments], times_s: Array, speeds: Indices,
                rate: float, per_s: float, std_mps2: float) -> Moments:
    """
    Return what is known when a vehicle may begin to change its speed after any pair but the last.

    :param steady: what is known when it does not: its speed is a Wiener process.
    :param times_s: (n,) stamps, s.
    :param speeds: (n,) indices of the speeds.
    :param rate: random walk of the speed, m/s/sqrt(s).
    :param per_s: how often it begins, 1/s.
    :param std_mps2: 1-sigma of the acceleration from then on.
    """
    mean, covariance, gaps_s = steady.mean, steady.covariance, np.diff(times_s)
    first, last = speeds[:-1], speeds[-1]
    precision = 1 / rate ** 2
    # What an acceleration since pair j moves: (v_last - v_j) / rate^2, of all unknowns.
    moves = precision * (covariance[:, [last]] - covariance[:, first])  # (k, n - 1)
    change = moves[last] - moves[first, np.arange(len(first))]
    # What is known of the walk lessens what it tells, to nothing at most but for rounding.
    tells = np.maximum((times_s[-1] - times_s[:-1]) - change, 0.0)
    known = 1 / std_mps2 ** 2 + precision * tells
    told = precision * (mean[last] - mean[first])
    accelerations = told / known
    log_share = np.log(per_s * gaps_s) - 0.5 * np.log(known * std_mps2 ** 2) \
        + 0.5 * told * accelerations
    log_shares = np.append(log_share, 0.0) - per_s * (times_s[-1] - times_s[0])
    greatest = float(log_shares.max())
    shares = np.exp(log_shares - greatest)
    total = float(shares.sum())
    weights = shares[:-1] / total
    shift = moves @ (weights * accelerations)
    second = weights * (np.square(accelerations) + 1 / known)
    return Moments(
        mean + shift, covariance + (moves * second) @ moves.T - np.outer(shift, shift),
        steady.log_evidence + greatest + math.log(total))
