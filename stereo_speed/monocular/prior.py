# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The environment prior (2010, eq. 20-22) and accept-reject sampling (Algorithm 1)."""
from __future__ import annotations

from typing import Callable

import numpy as np
from numpy.typing import NDArray

from ..core.records import Array

Index = NDArray[np.intp]
_LEAST_LOG = -745.0  # smallest logarithm whose exponential is not 0


def log_acceptance(distance_px: Array, expected_px: Array, std_px: Array) -> Array:
    """
    Return the log probability that a candidate is accepted (eq. 22).

    :param distance_px: (N,), d of the candidates; an infinite one is never accepted.
    :param expected_px: (N,), d + d_rate of the states they come from.
    :param std_px: (N,), sigma_e.
    """
    with np.errstate(invalid='ignore', over='ignore'):
        z = (distance_px - expected_px) / std_px
        return np.asarray(np.where(np.isfinite(distance_px), -0.5 * z ** 2, -np.inf))


def accept_reject(propose: Callable[[Index], Array], log_chance: Callable[[Index, Array], Array],
                  count: int, rounds: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """
    Draw one sample per index by accept-reject (Algorithm 1), all indices at once.

    The number of rounds is bounded, because an index may have no acceptable candidate. In the last
    round the candidate is kept untested with its acceptance probability as importance weight,
    which gives the same distribution.

    :param propose: draws candidates (n, D) for indices (n,) from the instrumental distribution.
    :param log_chance: returns log acceptance probabilities (n,) of candidates.
    :param count: number of samples.
    :param rounds: maximum number of rounds.
    :param rng: random generator.
    :return: samples (count, D) and the logarithms (count,) of their weights, 0 where accepted.
    """
    waiting = np.arange(count)
    samples = propose(waiting)
    log_weights = np.zeros(count)
    for _ in range(rounds - 1):
        log_p = log_chance(waiting, samples[waiting])
        waiting = waiting[np.log(rng.random(len(waiting)) + 1e-300) > log_p]
        if not len(waiting):
            return samples, log_weights
        samples[waiting] = propose(waiting)
    # testing these as well would count the likely ones twice
    log_weights[waiting] = np.maximum(log_chance(waiting, samples[waiting]), _LEAST_LOG)
    return samples, log_weights
