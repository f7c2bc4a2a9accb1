# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Lines that wander: picks of one marking are off together, for it is not quite parallel to its road.

A machine that paints a line swerves by millimetres, and lays down the next stretch a step to the
side; where a marking is worn, what is left of it lies beside its middle. Refined picks tell that
much, and counted one by one they ask for a road that bends or climbs. So a line may be off its
place by a Gaussian process along it, of exponential correlation, for it may step. Whether lines
are, and how far, is decided by evidence, line by line, with road and scatter of the picks
eliminated in closed form.
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

_LEAST_SHARE = 1e-2  # of the variance of picks, below which a way to wander is left out
_LEAST_VARIANCE = 1e-12  # of picks by what they may scatter: exact ones are no wonder
_ROUNDS = 3  # in which the lines take turns, and in which the scatter of the picks is found
_WORTH = 4.0  # in the logarithm; what is less probable by more has neighbours that add little
_MOST_CHOICES = 300  # that are added up: of up to four lines all that there are


@dataclass(frozen=True, eq=False)
class Wander:
    """
    How lines may wander.

    :param std_m: (lines,) 1-sigma of each.
    :param off: (n, k) by how many of its sigmas each pick is off for each way to wander.
    """

    std_m: tuple[float, ...]
    off: Array

    @cached_property
    def told(self) -> float:
        """Return how many numbers picks tell of the ways to wander, which are orthogonal."""
        square = np.sum(self.off**2, axis=0)
        return float(np.sum(square / (1 + square)))

    @property
    def count(self) -> int:
        """Return the number of ways to wander."""
        return int(self.off.shape[1])


@dataclass(frozen=True, eq=False)
class Ways:
    """
    The ways in which one line may wander, orthogonal to each other.

    :param mine: (m,) numbers of its picks.
    :param vectors: (m, k) of unit length.
    :param variance: (k,) of the picks along them, in their own, for a line that wanders by 1 m.
    """

    mine: NDArray[np.intp]
    vectors: Array
    variance: Array

    @classmethod
    def of(cls, mine: NDArray[np.intp], per_m: Array, s_m: Array, length_m: float) -> Ways:
        """
        Return the ways of one line.

        :param mine: (m,) numbers of its picks.
        :param per_m: (m,) by how many of its sigmas a pick is off for each m of its line.
        :param s_m: (m,) arc lengths of the picks.
        :param length_m: over which the line's places are correlated.
        """
        alike = np.exp(-np.abs(s_m[:, None] - s_m) / length_m)
        variance, vectors = np.linalg.eigh(per_m[:, None] * alike * per_m)
        return cls(mine, vectors, np.maximum(variance, 0.0))


def wander_of(ways: Sequence[Ways], std_m: Sequence[float], count: int) -> Wander:
    """
    Return how lines may wander.

    :param std_m: (lines,) 1-sigma of each.
    :param count: of all picks.
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
    What is known of how far lines wander, before they are looked at.

    :param std_m: (t,) 1-sigmas that are tried, the first one 0.
    :param weight: (t,) how often each was seen before, as it were: lines of one road are alike, so
        the less was seen before, the more does one of them tell of the others.
    """

    std_m: tuple[float, ...]
    weight: tuple[float, ...]

    def log_chance(self, choice: Sequence[int]) -> float:
        """Return the logarithm of the probability of one of them for each line (Polya's urn)."""
        seen, out = list(self.weight), 0.0
        for i in choice:
            out += math.log(seen[i] / sum(seen))
            seen[i] += 1.0
        return out


class WanderEvidence:
    """
    The probability of the picks for lines that wander by as much, near one road.

    :param ways: in which the lines may wander, by picks as they are weighed here.
    :param residual: (n + m,) of picks and priors, in sigmas.
    :param jacobian: (n + m, size) their derivatives.
    :param beyond: what the squares of the picks' residuals have in addition, whatever the road.
    :param least_variance: of the picks, in their own.
    """

    def __init__(self, ways: Sequence[Ways], residual: Array, jacobian: Array, beyond: float,
                 least_variance: float) -> None:
        self.count = sum(len(line.mine) for line in ways)
        self.least = least_variance
        off, slope = residual[:self.count], jacobian[:self.count]
        before, weak = residual[self.count:], jacobian[self.count:]
        self.variances = [line.variance for line in ways]
        # Residual and derivatives side by side, so that one product makes all squares of them.
        both = np.column_stack([slope, off])
        self._along = [line.vectors.T @ both[line.mine] for line in ways]
        self._square = both.T @ both
        self._square[-1, -1] += beyond
        prior = np.column_stack([weak, before])
        self._prior = prior.T @ prior

    def at(self, std_m: Sequence[float]) -> float:
        """
        Return its logarithm, but for a constant, with the scatter of picks that they show.

        :param std_m: (lines,) by which they wander.
        """
        size, variance = len(self._square) - 1, 1.0
        for _ in range(_ROUNDS):
            square, log_det = self._loosened(std_m, variance)
            fitted = _without(square + variance * self._prior)
            # What the priors add is little beside that of many picks, and makes it no smaller.
            variance = max(fitted / max(self.count - size, 1), self.least, _LEAST_VARIANCE)
        square, log_det = self._loosened(std_m, variance)
        normal = square / variance + self._prior
        return -0.5 * (_without(normal) + self.count * float(np.log(variance)) + log_det
                       + float(np.linalg.slogdet(normal[:-1, :-1])[1]))

    def _loosened(self, std_m: Sequence[float], variance: float) -> tuple[Array, float]:
        """Return the squares of residual and derivatives, and the determinant they come with."""
        square, log_det = self._square, 0.0
        for along, own, std in zip(self._along, self.variances, std_m):
            if std:
                more = own * (std**2 / variance)
                square = square - along.T @ ((more / (1 + more))[:, None] * along)
                log_det += float(np.log1p(more).sum())
        return square, log_det

    def asked(self, may: MayWander) -> tuple[float, tuple[float, ...]]:
        """
        Return the greater probability, of lines that wander or do not, and (lines,) by how much.

        It is the logarithm, the chances beforehand included.

        :param may: what is known of lines.
        """
        still = (0,) * len(self._along)
        alone = self.at(still) + may.log_chance(still)
        wandering, std_m = self.wandering(may)
        return (wandering, std_m) if wandering > alone else (alone, (0.0,) * len(still))

    def wandering(self, may: MayWander) -> tuple[float, tuple[float, ...]]:
        """
        Return the logarithm of the probability that some line wanders, and (lines,) by how much.

        Where picks leave open how far a line wanders, its 1-sigma is that of all that may be.

        :param may: what is known of lines.
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
        """Return the scores of choices (lines,) up to the best one, and of all about it."""
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
    """Return what is left of the residual's square when all unknowns are fitted."""
    pull = square[:-1, -1]
    return float(square[-1, -1] - pull @ np.linalg.solve(square[:-1, :-1], pull))
