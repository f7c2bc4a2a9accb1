# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Gaussian priors and linear measurements as normal equations."""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from ..core.records import Array


class NormalEquations:
    """
    Normal equations of a least-squares problem, filled row by row.

    ``log_rows`` is the log determinant of the information of all rows.  It equals that of ``H`` if
    the rows form a chain: there are as many rows as unknowns, and in some order each row adds one
    unknown to the previous ones, with the factor 1.
    """

    def __init__(self, size: int) -> None:
        self.H, self.g = np.zeros((size, size)), np.zeros(size)
        self.log_rows = 0.0

    def __add__(self, other: NormalEquations) -> NormalEquations:
        """Return the sum of the information of both."""
        both = NormalEquations(len(self.g))
        both.H, both.g = self.H + other.H, self.g + other.g
        both.log_rows = self.log_rows + other.log_rows
        return both

    def leading(self, count: int) -> NormalEquations:
        """Return the equations of the first unknowns, if no row links them to the others."""
        first = NormalEquations(0)
        first.H, first.g = self.H[:count, :count], self.g[:count]
        first.log_rows = self.log_rows
        return first

    def row(self, columns: list[int], values: list[float], rest: float, std: float) -> None:
        """Add a row ``values . x[columns] = rest`` with a 1-sigma."""
        self.rows([columns], [values], np.array([std]), rest)

    def rows(self, columns: ArrayLike, values: ArrayLike, std: Array, rest: float = 0.0) -> None:
        """
        Add several rows at once.

        :param columns: (r, c) indices of the unknowns of each row.
        :param values: (r, c) or (c,) their factors.
        :param std: (r,) 1-sigma of each row.
        :param rest: right side of all rows.
        """
        at = np.asarray(columns)
        scaled = np.broadcast_to(np.asarray(values, float), at.shape) / std[:, None]
        self.log_rows -= 2 * float(np.log(np.broadcast_to(std, len(at))).sum())
        np.add.at(self.H, (at[:, :, None], at[:, None, :]),
                  scaled[:, :, None] * scaled[:, None, :])
        if rest:
            np.add.at(self.g, at, scaled * (rest / std)[:, None])

    def correlated(self, columns: ArrayLike, values: Array, covariance: Array) -> None:
        """
        Add several rows with correlated errors and right sides of 0.

        :param columns: (r, c) indices of the unknowns of each row.
        :param values: (r, c) their factors.
        :param covariance: (r, r) covariance of the rows.
        """
        of, at = np.unique(np.asarray(columns), return_inverse=True)
        j = np.zeros((len(values), len(of)))
        np.put_along_axis(j, at.reshape(values.shape), values, axis=1)
        factor = _factor(covariance)
        half = lapack.dtrtrs(factor, j, lower=1)[0]
        self.log_rows -= 2 * float(np.log(np.diag(factor)).sum())
        self.H[np.ix_(of, of)] += half.T @ half


@dataclass(frozen=True, eq=False)
class Conditioned:
    """
    A Gaussian posterior.

    :param mean: mean of the unknowns.
    :param log_evidence: log evidence of the measurements, up to terms independent of the prior.
    :param factor: lower Cholesky factor of the information.
    """

    mean: Array
    log_evidence: float
    factor: Array

    @cached_property
    def covariance(self) -> Array:
        """Return the covariance of the unknowns."""
        half = lapack.dpotri(self.factor, lower=1)[0]  # the lower triangle of the covariance
        whole = half + half.T
        np.fill_diagonal(whole, np.diag(half))
        return np.asarray(whole)


def condition(prior: NormalEquations, H: Array, g: Array, *, chain: bool = False) -> Conditioned:
    """
    Return a Gaussian conditioned on linear measurements of its first unknowns.

    :param prior: the Gaussian prior.
    :param H: (m, m) information of the measurements about the first m unknowns.
    :param g: (m,) information times measurement.
    :param chain: whether the prior's rows form a chain, so that its determinant is known.
    """
    m = len(g)
    total, right = prior.H.copy(), prior.g.copy()
    total[:m, :m] += H
    right[:m] += g
    factor = _factor(total)
    mean = lapack.dpotrs(factor, right, lower=1)[0]
    log_det = (prior.log_rows if chain else _log_det(prior.H)) - 2 * float(
        np.log(np.diag(factor)).sum())
    return Conditioned(mean, 0.5 * (log_det + float(right @ mean)), factor)


def _log_det(information: Array) -> float:
    """Return the log determinant of a symmetric positive definite matrix."""
    factor, failed = lapack.dpotrf(information, lower=1)
    if not failed:
        return 2 * float(np.log(np.diag(factor)).sum())
    # A chain almost without noise may be singular by rounding; measurements can still resolve it.
    known = np.linalg.eigvalsh(information)
    return float(np.log(np.maximum(known, np.finfo(float).eps * known[-1])).sum())


def _factor(information: Array) -> Array:
    """Return the lower Cholesky factor of a symmetric positive definite matrix."""
    factor, failed = lapack.dpotrf(information, lower=1)
    if failed:
        raise np.linalg.LinAlgError('information matrix not positive definite')
    return np.asarray(factor)
