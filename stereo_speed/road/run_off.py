# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Roads whose superelevation is built up in view.

Along the *run-off* at the entry or exit of a bend the crossfall changes linearly, with kinks at
both ends, while the curvature changes along a clothoid.  The road turns about one of its lines or
its middle, the *axis*, which keeps its grade; all other lines climb or fall.  Polynomials leave
centimetres at the kinks.  Here the rate of the crossfall and the curvature are series of cosines
along the road.  The coefficients of the rate, which has steps, get smaller as 1/n, and those of
the curvature, which has kinks, as 1/n^2.
"""
from __future__ import annotations

import numpy as np

from ..core.records import Array

TERMS = 24  # cosines of each series: the last one has a half period of about 2 m
# Parameters: rate of the crossfall (TERMS), curvature (TERMS), rad per half length of the road,
# and the offset of the axis from the reference line, m.
RUN_OFF = 2 * TERMS + 1
AXIS_STD_M = 5.0  # prior 1-sigma of that offset: the reference line is one of the road's lines
# The constant belongs to the rate alone: curved roads have one of their own.
_RATES: Array = np.arange(TERMS, dtype=np.float64)
_BENDS: Array = _RATES + 1


def changes(numbers: Array, u: Array, half_length_m: float) -> tuple[Array, Array, Array]:
    """
    Return what a run-off adds to heading, grade and crossfall (..., n), rad; or 0 for none.

    :param numbers: (..., RUN_OFF) parameters, or (..., 0) for a road without a run-off.
    :param u: (n,) places along the road, evenly about its middle, in half lengths.
    :param half_length_m: half length of the road, m.
    """
    if not numbers.shape[-1]:
        zero = np.zeros(numbers.shape[:-1] + (1,))
        return zero, zero, zero
    rates, bends, axis_m = np.split(numbers, [TERMS, 2 * TERMS], axis=-1)
    # The axis keeps its grade, so the reference line climbs by its distance from it.
    climb = -axis_m / half_length_m * (rates @ _cosines(_RATES, u))
    return bends @ _integrals(_BENDS, u), climb, rates @ _integrals(_RATES, u)


def prior_std(curvature_std: float, twist_std: float) -> Array:
    """
    Return the prior 1-sigmas (RUN_OFF,) of the parameters.

    :param curvature_std: 1-sigma of the curvature, rad per half length.
    :param twist_std: 1-sigma of the rate of the crossfall, rad per half length.
    """
    return np.concatenate(
        [twist_std / np.maximum(_RATES, 1), curvature_std / _BENDS**2, [AXIS_STD_M]])


def axes_m(offsets_m: Array) -> Array:
    """Return the axes (3,) to start from: the outer lines and the middle between them, m."""
    return np.asarray(np.linspace(offsets_m.min(), offsets_m.max(), 3))


def _cosines(orders: Array, u: Array) -> Array:
    """Return cosines (k, n), whose periods fit twice between the first and the last place."""
    return np.asarray(np.cos(np.outer(orders, _phase(u))))


def _integrals(orders: Array, u: Array) -> Array:
    """Return the integrals (k, n) of the cosines from the middle of the road."""
    k, width = orders[:, None], u[-1] - u[0]
    waves = (np.sin(k * _phase(u)) - np.sin(k * np.pi / 2)) / np.maximum(k, 1) * (width / np.pi)
    return np.asarray(np.where(k > 0, waves, u))


def _phase(u: Array) -> Array:
    """Return the phase (n,) of the first cosine: 0 at the first place, pi at the last."""
    return np.asarray(np.pi * (u - u[0]) / (u[-1] - u[0]))
