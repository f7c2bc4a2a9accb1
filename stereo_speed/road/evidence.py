# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The evidence of fitted roads: the best of several, and its rivals of similar evidence."""
from __future__ import annotations

from dataclasses import replace
from typing import Optional, Sequence

import numpy as np

from .fitted import least_variance, RoadFit
from .model import RoadShape
from .wander import Wander
from .wander_search import log_probability

_RIVAL = 5e-3  # least odds of a rival family against the best one
_SAME = 0.01  # gain below which two roads of one family are the same but for rounding


def either(one: RoadFit, other: RoadFit) -> RoadFit:
    """
    Return the more probable one of two roads, with rivals of both and the other one among them.

    Each family counts once.  Of two roads of one family, about as probable, it is the first.
    """
    gain = log_probability(other) - log_probability(one)
    same = _family(one) == _family(other)
    best, rest = (other, one) if gain > (_SAME if same else 0.0) else (one, other)
    odds = float(np.exp(-abs(gain)))
    rivals = [*best.rivals, (odds, rest), *((odds * share, fit) for share, fit in rest.rivals)]
    families, kept = {_family(best)}, []
    for share, fit in sorted(rivals, key=lambda rival: -rival[0]):
        if share > _RIVAL and _family(fit) not in families:
            families.add(_family(fit))
            kept.append((share, fit))
    return replace(best, rivals=tuple(kept))


def _family(fit: RoadFit) -> tuple[RoadShape, bool]:
    """Return what tells roads of two families apart: their shapes, and whether lines wander."""
    return fit.problem.model.shape, fit.problem.wander is None


def with_rivals(fits: list[RoadFit]) -> RoadFit:
    """Return the road of greatest evidence, with roads of other families as its rivals."""
    logs = log_evidences(fits)
    top = max(logs)
    best = fits[logs.index(top)]
    odds: dict[RoadShape, tuple[float, RoadFit]] = {}
    for fit, log in zip(fits, logs):
        shape, chance = fit.problem.model.shape, float(np.exp(log - top))
        if shape != best.problem.model.shape and chance > odds.get(shape, (_RIVAL, fit))[0]:
            odds[shape] = chance, fit
    return replace(best, rivals=tuple(odds.values()))


def variance_of(fits: list[RoadFit]) -> float:
    """Return the variance of the picks, in units of their own, about the closest of some roads."""
    problem = fits[0].problem
    count = len(problem.picks.line)
    return max(min(f.cost / max(count - f.told, 1) for f in fits),
               least_variance(problem))


def log_evidences(fits: Sequence[RoadFit]) -> list[float]:
    """
    Return the log evidences (n,) of some roads, up to a constant.

    Roads whose lines wander alike share one variance of the picks, that about the closest of
    them.  Groups of roads whose lines wander differently have different variances, and how far
    lines wander has a prior of its own, so groups are compared by the probabilities of their best
    roads.

    :param fits: roads of the same picks, with the same unknowns of the rig.
    """
    alike: dict[Optional[Wander], list[int]] = {}
    for number, fit in enumerate(fits):
        alike.setdefault(fit.problem.wander, []).append(number)
    out = np.zeros(len(fits))
    for mine in alike.values():
        variance = variance_of([fits[i] for i in mine])
        out[mine] = [fits[i].log_evidence(variance) for i in mine]
        if len(alike) > 1:
            best = mine[int(np.argmax(out[mine]))]
            out[mine] += log_probability(fits[best]) - out[best]
    return [float(log) for log in out]


def best_of(fits: list[RoadFit]) -> RoadFit:
    """Return the road of greatest evidence."""
    logs = log_evidences(fits)
    return fits[logs.index(max(logs))]
