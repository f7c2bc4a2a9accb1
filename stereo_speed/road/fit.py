# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The joint fit of a road to all picks of all its lines, in both raw views.

The lines of a road are parallel, so they share one heading and one surface. The residual of a
pick is its distance from the projected line in units of its 1-sigma, so that far lines get their
proper weight. Evidence decides how the road curves, climbs and is banked: families of roads are
widened with further parameters as long as the marginal likelihood of the picks rises, given prior
knowledge of roads. Families of similar evidence remain as rivals, and their disagreement adds to
the uncertainty.

A marking may be displaced over some metres. The residuals of its picks are then correlated, which
no road explains. If the evidence supports it, lines may wander (``wander.py``), and the road is
searched again.

The right camera may have rotated since the calibration. Lines that are parallel in space reveal
this: they have one vanishing point in each view, and both must be the same direction. On demand
the three angles of the rotation are unknowns as well.
"""
from __future__ import annotations

from contextlib import suppress
from typing import Mapping, Optional

import numpy as np

from .evidence import best_of, either, with_rivals
from .families import as_built, explored, MOST
from .first_guess import guess_road, Hints, NoRoadError
from .fitted import RoadFit
from .line_kernels import REACH
from .problem import DriftPrior, Picks, RoadPrior, RoadProblem
from .solving import rebuilt, reshaped, same_family, solve
from .wander_search import asked_of, loosened
from ..core.records import Array
from ..estimation.robust import robust_std
from ..geometry.rig import StereoRig

# Scatter in 1-sigmas that not even 30 picks reach by chance; a road found from another guess may
# explain it.
_ASTRAY = 1.5
# Reach of the road in distances of the last node: up to there the cubic through the last nodes
# extrapolates within 2 mm, even on an arc of 41 m radius.
OVERREACH = 1.1
_LENGTHS = 3  # most lengths of the road that are tried until it reaches its picks
_LONGER = REACH  # next half length as a multiple of the farthest foot, see _farthest_m
_WANDER_ROUNDS = 3  # most alternations between finding roads and how far their lines wander
_SAME_WANDER = 0.3  # relative change of the 1-sigmas of wandering at which these have converged


def fit_road(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]],
             std_px: Optional[Mapping[str, tuple[Array, Array]]] = None,
             drift: Optional[DriftPrior] = None, prior: RoadPrior = RoadPrior(), *,
             near: Optional[RoadFit] = None) -> RoadFit:
    """
    Fit one road to the picks of its lines; the evidence decides how it curves and climbs.

    :param lines: maps names to raw pixels (left (n, 2), right (m, 2)), in order along travel.
    :param std_px: maps names to 1-sigmas (left (n,), right (m,)), px; see :meth:`Picks.of`.
    :param drift: see :class:`RoadProblem`.
    :param prior: prior knowledge of any road.
    :param near: approximate road with the same lines to start from; None finds a start.
    :raises NoRoadError: the picks give no road to start from.
    """
    picks = Picks.of(lines, std_px, prior.pick_std_px)
    # Few picks, such as 2 per line, suffice only for a straight road.
    most = min(MOST.curvature, len(picks.line) // 2 - 4 - len(lines))
    if near is not None:
        return _from_near(near, RoadProblem(rig, picks, near.problem.model, drift, prior), most)
    return _reaching(rig, lines, picks, drift, prior, most)


def reach_m(fit: RoadFit) -> float:
    """Return up to which distance from its middle, along it, a road is known, m."""
    return OVERREACH * float(fit.problem.model.s_m[-1])


def _from_near(near: RoadFit, problem: RoadProblem, most: int) -> RoadFit:
    """Fit a road from an approximate one; ``most`` as for :func:`_reaching`."""
    fit = same_family(near, problem)
    return fit if most < 1 else _search([fit], most)


def _reaching(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]], picks: Picks,
              drift: Optional[DriftPrior], prior: RoadPrior, most: int) -> RoadFit:
    """
    Fit roads until one reaches its picks and one agrees; return that of greatest evidence.

    The initial guess lies in a plane, which may intersect the rays of far picks too early and so
    be too short: longer roads are tried.  Or the plane is wrong, as curves through the picks of
    some lines are where these have gaps in a sharp bend: planes of single lines are tried.  The
    other arguments are those of :func:`fit_road`.

    :param most: largest number of curvature coefficients.
    """
    def attempt(hints: Hints) -> RoadFit:
        return _from_guesses(rig, lines, picks, drift, prior, most, hints)
    tries = [attempt(Hints())]
    with suppress(NoRoadError, np.linalg.LinAlgError):  # the road is too long for its picks
        while len(tries) < _LENGTHS and not _reaches(tries[-1]):
            tries.append(attempt(Hints(least_half_m=_LONGER * _farthest_m(tries[-1]))))
    for number in range(len(lines)):
        if any(map(_agrees, tries)):
            break
        with suppress(NoRoadError, np.linalg.LinAlgError):  # the line alone gives none
            tries.append(attempt(Hints(plane_of=number)))
    return best_of(tries)


def _reaches(fit: RoadFit) -> bool:
    """Return whether a road is long enough for its picks."""
    return _farthest_m(fit) < reach_m(fit)


def _agrees(fit: RoadFit) -> bool:
    """Return whether most picks of each line lie on a road as closely as clicks would."""
    line, most_px = fit.problem.picks.line, _ASTRAY * fit.problem.prior.pick_std_px
    return all(robust_std(fit.feet.residual_px[line == i]) < most_px for i in np.unique(line))


def _farthest_m(fit: RoadFit) -> float:
    """Return the second largest distance of a line's feet from the middle, of any line, m."""
    line = fit.problem.picks.line
    return max(float(np.sort(np.abs(fit.feet.s_m[line == i]))[-2]) for i in np.unique(line))


def _from_guesses(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]], picks: Picks,
                  drift: Optional[DriftPrior], prior: RoadPrior, most: int, hints: Hints,
                  shown: bool = False) -> RoadFit:
    """
    Fit one road from guesses; the other arguments are those of :func:`fit_road`.

    :param most: largest number of curvature coefficients.
    :param hints: hints for the guesses.
    :param shown: whether the picks show a crest in a bend, as only precise ones do.
    """
    if picks.are_precise(prior):
        # With precise picks the cost has many local minima; fit with the 1-sigma of clicks first.
        clicks = Picks.of(lines, None, prior.pick_std_px)
        near = _from_guesses(rig, lines, clicks, drift, prior, most, hints, shown=True)
        return _from_near(near, RoadProblem(rig, picks, near.problem.model, drift, prior), most)
    rotated = np.zeros(0) if drift is None else drift.mean_rad
    fits = []
    for terms in range(max(min(most, 2), 0) + 1):  # each from a guess of its own
        model, start = guess_road(rig, list(lines.values()), terms, hints)
        fits.append(solve(RoadProblem(rig, picks, model, drift, prior),
                          np.append(start, rotated)))
    if most < 1:
        return fits[0]
    # Straight roads have crests and sags; real bends climb and are banked.
    for fit in tuple(fits):
        shape = fit.problem.model.shape
        fits.append(reshaped(fit, shape._replace(tilt=2) if shape.curvature
                             else shape._replace(vertical=2)))
    found = _search(fits, most)
    if not (shown and found.problem.model.shape.curvature):
        return found
    # The search goes on from its best road only.  In a bend without a crest that is one with more
    # and more coefficients of curvature and crossfall, which explain a crest in part.
    with suppress(NoRoadError, np.linalg.LinAlgError):  # the picks give no bend over a crest
        return either(found, _search(_over_crests(fits), most))
    return found


def _over_crests(fits: list[RoadFit]) -> list[RoadFit]:
    """Fit bends with a crest or sag, as a polynomial and as built, starting from plane ones."""
    out = []
    for fit in fits:
        shape = fit.problem.model.shape
        if shape.tilt:
            wavy = reshaped(fit, shape._replace(vertical=2))
            out += [wavy, *(rebuilt(wavy, one) for one in as_built(wavy.problem.model.shape))]
    return out


def _search(fits: list[RoadFit], most: int) -> RoadFit:
    """
    Return the road of greatest evidence, with its rivals.

    If the residuals of a line are correlated, lines may wander, and the road is searched again.

    :param fits: roads to start from.
    :param most: largest number of curvature coefficients.
    """
    strict = explored(fits, most)
    known = best_of(strict)
    asked, found = asked_of(known), None
    for _ in range(_WANDER_ROUNDS):
        if not any(asked.std_m):
            break
        found = explored(loosened(known, asked), most)
        known, before = best_of(found), asked
        asked = asked_of(known)
        if (np.allclose(asked.std_m, before.std_m, rtol=_SAME_WANDER, atol=0.0)
                and any(asked.shape == fit.problem.model.shape for fit in found)):
            break
    if found is None:
        return with_rivals(strict)
    return either(with_rivals(strict), with_rivals(found))
