# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Lines that wander: a marking is not exactly parallel to its road, so its picks are correlated.

A marking machine swerves by millimetres and starts the next stretch with a lateral step; the
remains of a worn marking lie beside its middle. Refined picks are precise enough to show this.
If they counted as independent, they would suggest a road that bends or climbs. A line may
therefore be displaced by a Gaussian process along it, with an exponential correlation because the
displacement may step. Evidence decides line by line whether lines wander and how far, with the
road and the scatter of the picks eliminated in closed form.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
import math
from typing import Sequence

import numpy as np
from numpy.typing import NDArray

from ..core.records import Array

_LEAST_SHARE = 1e-2  # share of the variance of picks below which a way to wander is left out
_LEAST_VARIANCE = 1e-12  # lower bound of the variance of picks, which exact ones would undercut
_ROUNDS = 3  # rounds of the search over the lines, and of the iteration for the scatter of picks
_WORTH = 4.0  # log odds below the best choice beyond which the neighbours of a choice add little
_MOST_CHOICES = 300  # limit of choices that are summed; for up to four lines these are all


@dataclass(frozen=True, eq=False)
class Wander:
    """
    How lines may wander, by orthogonal ways whose coefficients have unit prior variance.

    :param std_m: (lines,) 1-sigma of the displacement of each line, m.
    :param off: (n, k) displacement of each pick, in its sigmas, per unit of each way to wander.
    """

    std_m: tuple[float, ...]
    off: Array

    @cached_property
    def told(self) -> float:
        """Return the effective number of coefficients that the picks determine."""
        square = np.sum(self.off**2, axis=0)
        return float(np.sum(square / (1 + square)))

    @property
    def count(self) -> int:
        """Return the number of ways to wander."""
        return int(self.off.shape[1])


@dataclass(frozen=True, eq=False)
class Ways:
    """
    The orthogonal ways in which one line may wander.

    :param mine: (m,) indices of its picks.
    :param vectors: (m, k) unit vectors of the displacements of the picks.
    :param variance: (k,) variances along them, in units of those of the picks, for a line whose
        displacement has a 1-sigma of 1 m.
    """

    mine: NDArray[np.intp]
    vectors: Array
    variance: Array

    @classmethod
    def of(cls, mine: NDArray[np.intp], per_m: Array, s_m: Array, length_m: float) -> Ways:
        """
        Return the ways in which one line may wander.

        :param mine: (m,) indices of its picks.
        :param per_m: (m,) displacement of each pick, in its sigmas, per m of its line.
        :param s_m: (m,) arc lengths of the picks, m.
        :param length_m: correlation length of the displacement, m.
        """
        alike = np.exp(-np.abs(s_m[:, None] - s_m) / length_m)
        variance, vectors = np.linalg.eigh(per_m[:, None] * alike * per_m)
        return cls(mine, vectors, np.maximum(variance, 0.0))


def wander_of(ways: Sequence[Ways], std_m: Sequence[float], count: int) -> Wander:
    """
    Return how lines may wander.

    :param ways: ways in which each line may wander.
    :param std_m: (lines,) 1-sigma of the displacement of each line, m.
    :param count: number of all picks.
    """
    columns = [np.zeros((count, 0))]
    for line, std in zip(ways, std_m):
        variance = line.variance * std**2
        kept = variance > _LEAST_SHARE
        block = np.zeros((count, int(kept.sum())))
        block[line.mine] = line.vectors[:, kept] * np.sqrt(variance[kept])
        columns.append(block)
    return Wander(tuple(float(std) for std in std_m), np.concatenate(columns, axis=1))


@dataclass(frozen=True)
class MayWander:
    """
    The prior of how far the lines of a road wander, a Polya urn.

    :param std_m: (t,) 1-sigmas to choose from, the first one 0, m.
    :param weight: (t,) initial weights of the choices, in lines.  The smaller they are, the more
        does one line tell about the others, as the lines of one road are alike.
    """

    std_m: tuple[float, ...]
    weight: tuple[float, ...]

    def log_chance(self, choice: Sequence[int]) -> float:
        """Return the log probability of a choice of a 1-sigma, by its index, for each line."""
        seen, out = list(self.weight), 0.0
        for i in choice:
            out += math.log(seen[i] / sum(seen))
            seen[i] += 1.0
        return out


class WanderEvidence:
    """
    The evidence of the picks as a function of how far lines wander, near one road.

    :param ways: ways in which the lines may wander, with the picks weighted as here.
    :param residual: (n + m,) residuals of picks and priors, in sigmas.
    :param jacobian: (n + m, size) their derivatives.
    :param beyond: constant to add to the sum of squares of the picks' residuals.
    :param least_variance: least variance of the picks, in units of their own.
    :param untold: number of unknowns that the picks do not determine.
    """

    def __init__(self, ways: Sequence[Ways], residual: Array, jacobian: Array, beyond: float,
                 least_variance: float, untold: float = 0.0) -> None:
        self.count = sum(len(line.mine) for line in ways)
        self.least, self.untold = least_variance, untold
        off, slope = residual[:self.count], jacobian[:self.count]
        before, weak = residual[self.count:], jacobian[self.count:]
        self.variances = [line.variance for line in ways]
        # With derivatives and residual side by side, one product gives the normal equations.
        both = np.column_stack([slope, off])
        self._along = [line.vectors.T @ both[line.mine] for line in ways]
        self._square = both.T @ both
        self._square[-1, -1] += beyond
        prior = np.column_stack([weak, before])
        self._prior = prior.T @ prior

    def at(self, std_m: Sequence[float]) -> float:
        """
        Return the log evidence, up to a constant, with the scatter of the picks estimated.

        :param std_m: (lines,) 1-sigma of the displacement of each line, m.
        """
        size, variance = len(self._square) - 1 - self.untold, 1.0
        for _ in range(_ROUNDS):
            square, log_det = self._loosened(std_m, variance)
            fitted = _without(square + variance * self._prior)
            # The priors add little compared with many picks, and cannot make it smaller.
            variance = max(fitted / max(self.count - size, 1), self.least, _LEAST_VARIANCE)
        square, log_det = self._loosened(std_m, variance)
        normal = square / variance + self._prior
        return -0.5 * (_without(normal) + self.count * float(np.log(variance)) + log_det
                       + float(np.linalg.slogdet(normal[:-1, :-1])[1]))

    def _loosened(self, std_m: Sequence[float], variance: float) -> tuple[Array, float]:
        """Return the normal equations with the wandering eliminated, and its log determinant."""
        square, log_det = self._square, 0.0
        for along, own, std in zip(self._along, self.variances, std_m):
            if std:
                more = own * (std**2 / variance)
                square = square - along.T @ ((more / (1 + more))[:, None] * along)
                log_det += float(np.log1p(more).sum())
        return square, log_det

    def asked(self, may: MayWander) -> tuple[float, tuple[float, ...]]:
        """
        Return the greater log probability, of wandering lines or of none, prior included.

        :param may: prior of how far lines wander.
        :return: the log probability and (lines,) 1-sigma of the displacement of each line, m.
        """
        still = (0,) * len(self._along)
        alone = self.at(still) + may.log_chance(still)
        wandering, std_m = self.wandering(may)
        return (wandering, std_m) if wandering > alone else (alone, (0.0,) * len(still))

    def wandering(self, may: MayWander) -> tuple[float, tuple[float, ...]]:
        """
        Return the log probability that some line wanders.

        If the picks do not determine how far a line wanders, its 1-sigma is averaged over all
        choices by their probabilities.

        :param may: prior of how far lines wander.
        :return: the log probability and (lines,) 1-sigma of the displacement of each line, m.
        """
        known = self._known(may)
        known.pop((0,) * len(self._along), None)
        if not known:
            return -math.inf, (0.0,) * len(self._along)
        scores = np.array(list(known.values()))
        shares = np.exp(scores - scores.max())
        variance = shares @ np.square(may.std_m)[np.array(list(known))] / shares.sum()
        return (float(scores.max() + np.log(shares.sum())),
                tuple(float(std) for std in np.sqrt(variance)))

    def _known(self, may: MayWander) -> dict[tuple[int, ...], float]:
        """Return the scores of the choices (lines,) on the way to the best one and around it."""
        known: dict[tuple[int, ...], float] = {}

        def score(choice: tuple[int, ...]) -> float:
            if choice not in known:
                known[choice] = self.at([may.std_m[i] for i in choice]) + may.log_chance(choice)
            return known[choice]
        lines, numbers = len(self._along), range(len(may.std_m))
        best = max(((i,) * lines for i in numbers), key=score)
        for _ in range(_ROUNDS):
            before = best
            for line in range(lines):
                best = max((best[:line] + (i,) + best[line + 1:] for i in numbers), key=score)
            if best == before:
                break
        spread: set[tuple[int, ...]] = set()
        while len(known) < _MOST_CHOICES:
            least = max(known.values()) - _WORTH
            new = [one for one in known if one not in spread and known[one] > least]
            if not new:
                break
            spread.update(new)
            for one in new:
                for line, i in product(range(lines), numbers):
                    score(one[:line] + (i,) + one[line + 1:])
        return known


def _without(square: Array) -> float:
    """Return the sum of squared residuals that is left when all unknowns are fitted."""
    pull = square[:-1, -1]
    return float(square[-1, -1] - pull @ np.linalg.solve(square[:-1, :-1], pull))
