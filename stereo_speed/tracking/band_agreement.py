# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How well horizontal bands of a front agree on its speed, and what that adds to the 1-sigma.

Least squares takes what remains after the fit for errors that are independent from sample to
sample, but for a floor.  What a bumper mirrors moves over much of it together: a wrong speed fits
it as well, and the 1-sigma does not tell.  Fronts are built, and mirror the sky, the road and the
sun, in bands from the bonnet down to the bumper.  So a pass is solved again without each of these
bands.  The jackknife gives the variance of its speed from the spread of these solutions, whatever
errors are like within a band (J. W. Tukey, "Bias and confidence in not quite large samples",
Annals of Mathematical Statistics 29, 1958, p. 614; J. Shao, C. F. J. Wu, "A general theory for
jackknife variance estimation", Annals of Statistics 17, 1989, with groups left out).

Errors that all bands share do not show, so bands that agree prove nothing and the 1-sigma is never
smaller than by the fit.
"""
from __future__ import annotations

from typing import NamedTuple, Sequence

import numpy as np
from numpy.typing import NDArray

from .relief import NODES
from ..core.records import Array

BANDS = NODES[1]  # each of them has a row of nodes of the relief


class PartSpeed(NamedTuple):
    """
    The mean speed of a pass by a part of its front.

    :param mean_mps: the speed, m/s.
    :param variance: its variance by the fit, m^2/s^2.
    """

    mean_mps: float
    variance: float


def all_but_one(grid_shape: tuple[int, int]) -> list[NDArray[np.bool_]]:
    """
    Return the samples (G,) of a front without each of its bands, the highest band first.

    :param grid_shape: rows and columns of the grid of samples, which are in order of rows.
    """
    rows, columns = grid_shape
    band = np.repeat(np.arange(rows) * BANDS // rows, columns)
    return [np.asarray(band != k) for k in range(BANDS)]


def jackknife_variance(without_each: Array) -> float:
    """Return the variance of an estimate from those (k,) without each of k groups of data."""
    return (len(without_each) - 1) * float(np.var(without_each))


def error_scale(variance: float, without_each: Sequence[PartSpeed], share: float) -> float:
    """
    Return the factor on the covariance of matching, by how well the bands of a front agree.

    The fit explains a jackknife variance up to its own, and more where one band has most of what
    there is to see: estimates from all data and from a part of them differ by the difference of
    their variances (J. A. Hausman, "Specification tests in econometrics", Econometrica 46, 1978).

    :param variance: variance of the mean speed by the fit of the whole front, m^2/s^2.
    :param without_each: mean speeds without each of k bands.
    :param share: share that counts of what the fit does not explain.
    :return: at least 1.
    """
    means, variances = np.transpose(without_each)
    lost = np.maximum(variances - variance, 0.0)
    explained = max(variance, (len(lost) - 1) * float(lost.mean()))
    return 1 + share * max(jackknife_variance(means) - explained, 0.0) / variance
