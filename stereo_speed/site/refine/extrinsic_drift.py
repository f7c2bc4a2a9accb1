# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The decision whether the right camera has rotated since its calibration.

Each of its three angles either stands as calibrated, within a small tolerance, or has moved by up
to some hundredths of a degree. The eight combinations are weighed by how well they predict the
angles that the lines and the background show. What the lines show depends on the assumed family
of roads, because the shape of a road can look like a pan; all plausible families are therefore
weighed together with the combinations. The covariance includes all remaining uncertainty, also
that of the decision.
"""
from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple, Sequence

import numpy as np

from .config import RefineConfig
from ...core.records import Array
from ...road.problem import RoadPrior


@dataclass(frozen=True, eq=False)
class Drift:
    """
    The estimated rotation of the right camera.

    :param shown_rad: (3,) pan, tilt and roll that the images alone show, rad.
    :param shown_std_rad: (3,) their 1-sigmas, rad.
    :param moved_probability: probability that any angle has moved beyond the tolerance.
    :param drift_rad: (3,) rotation to correct, rad; zero for the angles that have not moved in the
        most probable combination.
    :param covariance_rad2: (3, 3) covariance of the true angles about ``drift_rad``, rad^2.
    """

    shown_rad: Array
    shown_std_rad: Array
    moved_probability: float
    drift_rad: Array
    covariance_rad2: Array

    @property
    def moved(self) -> bool:
        """Return whether any angle is to be corrected."""
        return bool(np.any(self.drift_rad))

    @property
    def std_rad(self) -> Array:
        """Return the 1-sigmas (3,) of the true angles about ``drift_rad``, rad."""
        return np.asarray(np.sqrt(np.diag(self.covariance_rad2)))


class FamilyDrift(NamedTuple):
    """
    What lines and background show of the angles, assuming one family of roads.

    :param log_evidence: log evidence of all observations, up to a constant, with a flat prior of
        the angles.
    :param drift_rad: (3,) pan, tilt and roll, rad.
    :param covariance_rad2: (3, 3) their covariance without any prior, rad^2.
    """

    log_evidence: float
    drift_rad: Array
    covariance_rad2: Array


class _Branch(NamedTuple):
    """
    One combination of moved and unmoved angles, for one family of roads.

    :param score: its log probability, up to a constant.
    :param moved: which angles have moved.
    :param mean_rad: (3,) posterior mean of the angles in that case, rad.
    :param covariance_rad2: (3, 3) their posterior covariance, rad^2.
    """

    score: float
    moved: tuple[bool, ...]
    mean_rad: Array
    covariance_rad2: Array


def decide_drift(shown: Sequence[FamilyDrift], config: RefineConfig = RefineConfig(),
                 prior: RoadPrior = RoadPrior()) -> Drift:
    """
    Decide whether the camera has rotated, and about which axes.

    :param shown: what the images show, for each family of roads.
    :param config: gives how often and how far cameras move.
    :param prior: gives the tolerance of angles that have not moved.
    """
    branches = [_branch(s, moved, config, prior)
                for moved in product((False, True), repeat=3) for s in shown]
    weight = _shares([b.score for b in branches])
    chances = {moved: sum(w for w, b in zip(weight, branches) if b.moved == moved)
               for moved in product((False, True), repeat=3)}
    best = max(chances, key=lambda moved: chances[moved])
    mean = sum((w * b.mean_rad for w, b in zip(weight, branches) if b.moved == best),
               np.zeros(3)) / chances[best]
    # Angles that have not moved are not corrected.
    drift = np.where(best, mean, 0.0)
    by_images = _shares([s.log_evidence for s in shown])
    image_mean = np.asarray(sum(w * s.drift_rad for w, s in zip(by_images, shown)))
    return Drift(
        image_mean, np.sqrt(np.diag(_spread(image_mean, by_images, shown))),
        float(1 - chances[(False, False, False)]), drift,
        _spread(drift, weight,
                [FamilyDrift(0.0, b.mean_rad, b.covariance_rad2) for b in branches]))


def _shares(scores: Sequence[float]) -> Array:
    """Return normalised probabilities from log probabilities."""
    weight = np.exp(np.array(scores) - max(scores))
    return np.asarray(weight / weight.sum())


def _spread(about_rad: Array, weight: Array, parts: Sequence[FamilyDrift]) -> Array:
    """Return the covariance (3, 3) of a mixture about a given mean."""
    return np.asarray(sum(
        w * (p.covariance_rad2 + np.outer(p.drift_rad - about_rad, p.drift_rad - about_rad))
        for w, p in zip(weight, parts)))


def _branch(shown: FamilyDrift, moved: tuple[bool, ...], config: RefineConfig, prior: RoadPrior
            ) -> _Branch:
    """Return the posterior of one combination for one family of roads."""
    mean, covariance = shown.drift_rad, shown.covariance_rad2
    still, far = np.radians(prior.calibrated_std_deg)**2, np.radians(config.moved_std_deg)**2
    before = np.diag(np.where(moved, far, still))
    total = covariance + before
    gain = before @ np.linalg.inv(total)
    score = -0.5 * (mean @ np.linalg.solve(total, mean) + np.linalg.slogdet(total)[1])
    chance = config.moved_probability
    score += sum(np.log(chance if m else 1 - chance) for m in moved) + shown.log_evidence
    return _Branch(float(score), moved, gain @ mean, before - gain @ before)
