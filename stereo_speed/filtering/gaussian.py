# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Gaussian priors and linear measurements as normal equations."""
from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import lapack

from ..records import Array


class NormalEquations:
    """Normal equations of a least-squares problem, filled row by row."""

    def __init__(self, size: int) -> None:
        self.H, self.g = np.zeros((size, size)), np.zeros(size)

    def __add__(self, other: NormalEquations) -> NormalEquations:
        """Put together what both say."""
        both = NormalEquations(len(self.g))
        both.H, both.g = self.H + other.H, self.g + other.g
        return both

    def row(self, columns: list[int], values: list[float], rest: float, std: float) -> None:
        """Add ``values . x[columns] = rest`` with a 1-sigma."""
        self.rows([columns], [values], np.array([std]), rest)

    def rows(self, columns: Any, values: Any, std: Array, rest: float = 0.0) -> None:
        """
        Add several rows at once.

        :param columns: (r, c) indices of the unknowns of each row.
        :param values: (r, c) or (c,) their factors.
        :param std: (r,) 1-sigma of each row.
        """
        at = np.asarray(columns)
        scaled = np.broadcast_to(np.asarray(values, float), at.shape) / std[:, None]
        np.add.at(self.H, (at[:, :, None], at[:, None, :]),
                  scaled[:, :, None] * scaled[:, None, :])
        if rest:
            np.add.at(self.g, at, scaled * (rest / std)[:, None])

    def correlated(self, columns: Any, values: Any, covariance: Array) -> None:
        """
        Add several rows whose errors belong together; they rest at 0.

        :param columns: (r, c) indices of the unknowns of each row.
        :param values: (r, c) their factors.
        :param covariance: (r, r) of the rows.
        """
        at = np.asarray(columns)
        j = np.zeros((len(at), len(self.g)))
        np.put_along_axis(j, at, np.asarray(values, float), axis=1)
        self.H += j.T @ np.linalg.solve(covariance, j)


def condition(prior: NormalEquations, H: Array, g: Array) -> tuple[Array, Array, float]:
    """
    Condition a Gaussian prior on linear measurements of its first unknowns.

    :param H: (m, m) information of the measurements about the first m unknowns.
    :param g: (m,) information times measurement.
    :return: posterior mean and covariance, and the log evidence up to what does not depend on
        the information matrix of the prior.
    """
    m = len(g)
    total, right = prior.H.copy(), prior.g.copy()
    total[:m, :m] += H
    right[:m] += g
    covariance, after = _inverse(total)
    mean = covariance @ right
    log_det = 2 * float(np.log(np.diag(np.linalg.cholesky(prior.H))).sum())
    return mean, covariance, 0.5 * (log_det - after + float(right @ mean))


def _inverse(information: Array) -> tuple[Array, float]:
    """Invert a symmetric positive definite matrix; its logarithmic determinant."""
    factor, failed = lapack.dpotrf(information, lower=1)
    if failed:
        raise np.linalg.LinAlgError('information matrix not positive definite')
    half = lapack.dpotri(factor, lower=1)[0]  # its lower triangle
    log_det = 2 * float(np.log(np.diag(factor)).sum())
    return np.tril(half) + np.tril(half, -1).T, log_det
