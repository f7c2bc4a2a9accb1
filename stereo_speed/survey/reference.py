# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Compare measured passes with a reference of known speeds: errors, and the claims they support.

The limit of error is that of OIML R 91 (6.4): 3 km/h up to 100 km/h, 3 % above.  A reference is
good enough if its expanded uncertainty (two of its 1-sigmas) is at most a third of that limit.
"""
from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
import math
from typing import Optional, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import beta, binom

from .traffic import Vehicle
from ..core.units import KMH_MPS

COVERAGE = 2.0  # coverage factor of an expanded uncertainty
REFERENCE_SHARE = 1 / 3  # greatest uncertainty of a reference, as a share of the limit of error
_LIMIT_MPS, _LIMIT_SHARE, _LIMIT_FROM_MPS = 3 * KMH_MPS, 0.03, 100 * KMH_MPS
_MEAN_MPS = 1 * KMH_MPS  # limit of the mean error over a series on the road
_CONFIDENCE = 0.95
_FAR_S = 1e6  # cost of a forbidden match
_MOST_PASSES = 10 ** 12  # upper end of the search for a number of passes
# Claims, and the number of passes each requires: Orden ICT/155/2020; KB 12-10-2010.
CLAIMS = (('approval', 500), ('after installation', 50), ('yearly', 30))
RELIABILITY = 0.998


def error_limit_mps(speed_mps: float) -> float:
    """Return the limit of error at a true speed, m/s."""
    return _LIMIT_SHARE * speed_mps if speed_mps > _LIMIT_FROM_MPS else _LIMIT_MPS


@dataclass(frozen=True, kw_only=True)
class ReferenceSpeed:
    """
    A vehicle as measured by a reference instrument.

    :param time_ns: time of the measurement by the clock of the pairs, ns.
    :param lane: name of its lane.
    :param speed_mps: its speed.
    :param std_mps: 1-sigma of the speed.
    """

    time_ns: int
    lane: str
    speed_mps: float
    std_mps: float

    @property
    def limit_mps(self) -> float:
        """Return the limit of error at this speed."""
        return error_limit_mps(self.speed_mps)

    @property
    def is_good_enough(self) -> bool:
        """Return whether the reference is accurate enough for a verification."""
        return COVERAGE * self.std_mps <= REFERENCE_SHARE * self.limit_mps


@dataclass(frozen=True, kw_only=True)
class Match:
    """
    A vehicle of the reference, and the pass matched to it.

    :param reference: the vehicle of the reference.
    :param vehicle: the pass; None where there is none.
    """

    reference: ReferenceSpeed
    vehicle: Optional[Vehicle]

    @property
    def error_mps(self) -> Optional[float]:
        """Return measured minus reference speed; None where nothing was measured."""
        if self.vehicle is None or self.vehicle.speed_mps is None:
            return None
        return self.vehicle.speed_mps - self.reference.speed_mps

    @property
    def counts(self) -> bool:
        """Return whether there is an error and the reference is accurate enough."""
        return self.error_mps is not None and self.reference.is_good_enough


@dataclass(frozen=True, kw_only=True)
class Claim:
    """
    A claim, with the number of passes that it requires.

    :param name: name of the claim.
    :param wanted: number of passes required.
    :param had: number of passes that count.
    """

    name: str
    wanted: int
    had: int

    @property
    def missing(self) -> int:
        """Return how many passes are still missing."""
        return max(self.wanted - self.had, 0)


@dataclass(frozen=True, kw_only=True)
class Verification:
    """
    The result of comparing a series of passes with a reference; errors in m/s.

    :param matches: every vehicle of the reference.
    :param strangers: number of passes without a vehicle of the reference.
    :param counted: number of errors with accurate references; the figures are from these.
    :param mean_mps: mean error; None without any.
    :param std_mps: standard deviation; None for fewer than two.
    :param worst_mps: the error that is greatest relative to its limit.
    :param within: number of errors within the limit.
    :param claims: the claims, with the passes they require.
    """

    matches: Sequence[Match]
    strangers: int
    counted: int
    mean_mps: Optional[float]
    std_mps: Optional[float]
    worst_mps: Optional[float]
    within: int
    claims: Sequence[Claim]

    # Each vehicle of the reference either counts or is in one of these three groups.

    @property
    def without_pass(self) -> int:
        """Return how many vehicles of the reference have no pass."""
        return sum(m.vehicle is None for m in self.matches)

    @property
    def rejected(self) -> int:
        """Return how many vehicles of the reference have a rejected pass."""
        return sum(m.vehicle is not None and m.error_mps is None for m in self.matches)

    @property
    def not_good_enough(self) -> int:
        """Return how many have an error, but a reference that is not accurate enough."""
        return sum(m.error_mps is not None and not m.counts for m in self.matches)

    @property
    def is_within(self) -> bool:
        """Return whether all errors, and their mean, are within the limits."""
        return (self.counted > 0 and self.within == self.counted
                and abs(self.mean_mps or 0.0) <= _MEAN_MPS)


def matched(references: Sequence[ReferenceSpeed], vehicles: Sequence[Vehicle],
            tolerance_s: float) -> list[Match]:
    """
    Match each vehicle of a reference with the pass of its lane that is nearest in time.

    The assignment is one to one; it has the most matches and, of those, the least total distance.

    :param tolerance_s: how long before the first pair or after the last a reference may be.
    """
    cost = np.full((len(references), len(vehicles)), _FAR_S)
    for i, one in enumerate(references):
        for k, vehicle in enumerate(vehicles):
            if vehicle.lane == one.lane:
                away_s = max(vehicle.first_ns - one.time_ns, one.time_ns - vehicle.last_ns,
                             0) * 1e-9
                if away_s <= tolerance_s:
                    cost[i, k] = away_s + 1e-6 * abs(vehicle.time_ns - one.time_ns) * 1e-9
    found: dict[int, Vehicle] = {}
    if cost.size:
        rows, columns = linear_sum_assignment(cost)
        found = {int(i): vehicles[int(k)] for i, k in zip(rows, columns) if cost[i, k] < _FAR_S}
    return [Match(reference=one, vehicle=found.get(i)) for i, one in enumerate(references)]


def verification(references: Sequence[ReferenceSpeed], vehicles: Sequence[Vehicle],
                 tolerance_s: float) -> Verification:
    """Compare passes with a reference; see :func:`matched` for the tolerance."""
    matches = matched(references, vehicles, tolerance_s)
    rows = [(m.error_mps, m.reference.limit_mps) for m in matches
            if m.counts and m.error_mps is not None]
    errors = np.array([error for error, _ in rows])
    limits = np.array([limit for _, limit in rows])
    within = int(np.sum(np.abs(errors) <= limits))
    count, taken = len(rows), {id(m.vehicle) for m in matches if m.vehicle is not None}
    claims = [Claim(name=name, wanted=wanted, had=count) for name, wanted in CLAIMS]
    claims.append(Claim(name=f'{100 * RELIABILITY:g} % reliable',
                        wanted=passes_wanted(count - within), had=count))
    return Verification(
        matches=matches, strangers=len(vehicles) - len(taken), counted=count,
        mean_mps=float(errors.mean()) if count else None,
        std_mps=float(errors.std(ddof=1)) if count > 1 else None,
        worst_mps=float(errors[np.argmax(np.abs(errors) / limits)]) if count else None,
        within=within, claims=claims)


def passes_wanted(failures: int) -> int:
    """
    Return the number of passes that demonstrate ``RELIABILITY``, given the failures.

    The fewest n with P(failures or fewer of n | reliability) <= 1 - confidence (Clopper and
    Pearson 1934, one side).

    :param failures: errors beyond their limits.
    """
    return bisect_left(range(_MOST_PASSES), True, failures + 1, key=lambda n: bool(
        binom.cdf(failures, n, 1 - RELIABILITY) <= 1 - _CONFIDENCE))


def reliability_shown(counted: int, failures: int) -> float:
    """Return the reliability demonstrated by passes at 95 % confidence, as a share."""
    if counted <= failures:
        return 0.0
    failing = float(beta.ppf(_CONFIDENCE, failures + 1, counted - failures))
    return math.floor(1e6 * (1 - failing)) / 1e6
