# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Refinement of a rough site by some pairs of images, to a few hundredths of a pixel.

The rough clicks give a road, along which the lane markings are found in both raw views.  The
points found on all lines give a better road, along which the markings are found once more.
Together with the details of the background, the points then show whether the right camera has
rotated since its calibration.
"""
from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Iterable, Optional, Sequence

import numpy as np

from .clicked import ClickDistance, not_clicked
from .config import RefineConfig
from .cross_sections import LineView
from .disagreement import disagreement, KeptClicks, off_road_px
from .empty_road import Background, backgrounds
from .equal_sharpness import equally_sharp
from .extrinsic_drift import decide_drift, Drift, FamilyDrift
from .markings import Found, locate_both
from .rig_check import Epipolar, epipolar_check
from .strays import without_strays
from .unresolved import clicks_where_unresolved
from ..extras import RigCorrection
from ..file import PickedLine, Site
from ..lane_paths import (
    fit_lines, fit_roads, in_one_direction, lane_paths, may_be_picked, with_reversed)
from ...core.errors import SiteError
from ...core.records import Array, StereoPair
from ...geometry.rig import StereoRig
from ...road.evidence import log_evidences
from ...road.fitted import RoadFit
from ...road.lanes import LanePath
from ...road.problem import DriftPrior, RoadPrior, RoadProblem
from ...road.solving import in_family, same_family
from ...road.wander_search import log_probability

ROUNDS = 2  # rounds of finding the markings; a third changes nothing
_LOOSE = DriftPrior.loose(np.radians(0.2))  # prior of the drift while markings are searched
_UNKNOWN_RAD2 = np.eye(3) * np.radians(1.0)**2  # covariance of a drift without any observations
_END_STD_PX = 1.0  # 1-sigma of the ends of lines, which are extrapolated
_END_PX = 4.0  # least distance of a clicked end beyond the last found point for extrapolation
_LEAST_STILL_DEG = 1e-5  # 1-sigma that stands for an exact calibration
_DOUBTFUL = 0.01  # probability of a turn from which another fit must confirm it
_SAME_OPTIMUM = 0.25  # square of the distance, in sigmas, of drifts of one optimum
_STRAY_ROUNDS = 4  # most rounds of dropping strays, as each new road reveals others


@dataclass(frozen=True, eq=False)
class RefinedSite:
    """
    A refined site, and how it came about.

    :param site: site with the refined points, their 1-sigmas and the correction of the rig.
    :param rig: rig with that correction applied, which is the rig to measure with.
    :param lanes: paths of all lanes, for that rig.
    :param rough: the site before refinement.
    :param found: each line as found in the left and in the right view, by name.
    :param road: road fitted to the largest group of lines, with the corrected rig.
    :param drift: estimated rotation of the right camera.
    :param epipolar: rotation that the background shows; None if it has too few details.
    :param views: backgrounds of both views, equally sharp.
    :param config: parameters of the refinement.
    :param prior: prior knowledge of road and rig.
    :param kept_clicks: reason why the lines were left as clicked; empty if they are refined.
    """

    site: Site
    rig: StereoRig
    lanes: dict[str, LanePath]
    rough: Site
    found: Found
    road: Optional[RoadFit]
    drift: Drift
    epipolar: Optional[Epipolar]
    views: tuple[Background, Background]
    config: RefineConfig
    prior: RoadPrior
    kept_clicks: str = ''

    @property
    def lost(self) -> tuple[str, ...]:
        """Return the names of the lines that were not found and so stay as clicked."""
        return tuple(n for n in self.rough.picked if n not in self.found)

    @property
    def is_found(self) -> bool:
        """Return whether all lines were found in the images, and none stays as in the site."""
        return (not self.kept_clicks and set(self.found) == set(self.rough.lines)
                and not self.partly_clicked)

    @property
    def partly_clicked(self) -> tuple[str, ...]:
        """Return the names of the lines that were found in part and are clicked in the rest."""
        return tuple(name for name, views in self.found.items()
                     if any(view.is_clicked.any() for view in views))

    def road_with(self, names: Iterable[str]) -> Optional[RoadFit]:
        """Return the road if all the named lines belong to it, else None."""
        if self.road is None or not set(names) <= set(self.road.names):
            return None
        return self.road

    def line_view(self, road: RoadFit, name: str, right: bool) -> LineView:
        """Return one line of the road in one view."""
        return LineView(road, road.number(name), right, self.views[int(right)])


@dataclass(frozen=True, eq=False)
class _Checked:
    """
    What lines and background together show of the right camera.

    :param drift: its rotation.
    :param epipolar: rotation that the background shows; None if it has too few details.
    :param road: road fitted to the lines; None without lines.
    :param found: lines as found, without outliers.
    """

    drift: Drift
    epipolar: Optional[Epipolar]
    road: Optional[RoadFit]
    found: Found


def refine_site(site: Site, rig: StereoRig, pairs: Iterable[StereoPair],
                config: RefineConfig = RefineConfig(), prior: RoadPrior = RoadPrior()
                ) -> RefinedSite:
    """
    Refine a site by images.

    :param site: rough or already refined site; surveyed lines stay as they are. What an earlier
        refinement said of the errors of its paths no longer counts.
    :param rig: rig as calibrated, or with the site's correction applied.
    :param pairs: few or many pairs, spread over the time in which the site is used.
    :param config: parameters of the refinement.
    :param prior: prior knowledge of any road and rig.
    :raises SiteError: the rough lines give no usable road, or the drift is too large.
    :raises InputError: there are no pairs.
    """
    views = backgrounds(pairs, site.where)
    if any(rig.drift_rad):
        rig = rig.drifted(-np.array(rig.drift_rad))
    site = _judged_anew(site)
    rough, reversed_lines = in_one_direction(replace(site, correction=None), rig)
    roads, found = _search_roads(rough, rig, views, config, prior)
    equal = equally_sharp(views, found.values())
    if equal is not views:
        views = equal
        roads, found = _search_roads(rough, rig, views, config, prior)
    largest = max(roads, key=lambda fit: len(fit.names), default=None)
    checked = _checked(rough, largest, views, found, config, prior)
    found, drift, road = checked.found, checked.drift, checked.road
    correction = RigCorrection(drift.drift_rad, drift.covariance_rad2)
    better = replace(_with_found(rough, found), correction=correction if road else None)
    corrected = better.corrected_rig(rig)
    if road is not None:
        road = same_family(
            road, RoadProblem(corrected, road.problem.picks, road.problem.model, prior=prior,
                              wander=road.problem.wander))
        better = replace(better, lines={**better.lines, **{
            n: _with_ends(better.picked[n], rough.picked[n], road)
            for n in found if n in road.names}})
    result = with_reversed(better, reversed_lines)
    try:
        lanes = lane_paths(result, corrected, prior)
    except SiteError as error:
        if not found:
            raise
        kept: Optional[KeptClicks] = KeptClicks(
            f'the detected markings give no lane: {error.what}: found {error.found}', {})
    else:
        off_px = np.zeros(0) if road is None else off_road_px(road, rough, found)
        clicked = replace(site, correction=correction)
        kept = disagreement(lanes, clicked, corrected, off_px, config, prior)
    refined = RefinedSite(result, corrected, {}, site, found, road, drift, checked.epipolar, views,
                          config, prior)
    return replace(refined, lanes=lanes) if kept is None else _as_clicked(refined, rig, kept)


def _judged_anew(site: Site) -> Site:
    """Return a site whose lanes of picked lines are as certain as their lines say."""
    return replace(site, lanes=tuple(
        replace(lane, path_std=0.0) if set(lane.lines) & set(site.picked) else lane
        for lane in site.lanes))


def _search_roads(site: Site, rig: StereoRig, views: tuple[Background, Background],
                  config: RefineConfig, prior: RoadPrior) -> tuple[list[RoadFit], Found]:
    """Return the roads of a site, and their lines as found."""
    roads: list[RoadFit] = []
    found: Found = {}
    for fit in fit_roads(site, rig, _LOOSE, prior):
        fit, found = _search_road(site, fit, views, found, config)
        roads.append(fit)
    return roads, found


def _as_clicked(refined: RefinedSite, rig: StereoRig, kept: KeptClicks) -> RefinedSite:
    """
    Return the site as clicked, with the possible drift of the right camera as its covariance.

    :param refined: result of the refinement.
    :param rig: rig as calibrated.
    :param kept: why the refinement is not used, and how uncertain the paths are therefore.
    """
    drift = refined.drift
    spread = drift.covariance_rad2 + np.outer(drift.drift_rad, drift.drift_rad)
    drift = replace(drift, drift_rad=np.zeros(3), covariance_rad2=spread)
    lanes = tuple(replace(lane, path_std=kept.path_std.get(lane.name, lane.path_std))
                  for lane in refined.rough.lanes)
    site = replace(refined.rough, correction=RigCorrection(np.zeros(3), spread), lanes=lanes)
    return replace(refined, site=site, rig=rig, lanes=lane_paths(site, rig, refined.prior),
                   drift=drift, kept_clicks=kept.reason)


def _search_road(site: Site, fit: RoadFit, views: tuple[Background, Background], known: Found,
                 config: RefineConfig) -> tuple[RoadFit, Found]:
    """
    Find the lines of one road in both views, and fit a better road to them.

    :param known: lines that were already found along another road.
    :return: the better road, and all lines found so far.
    """
    found = dict(known)
    for number in range(ROUNDS):
        if number:
            fit = fit_lines(_with_found(site, found), fit.problem.rig, fit.names, _LOOSE,
                            fit.problem.prior, fit)
        for i, name in enumerate(fit.names):
            before = found.get(name)
            if name in known or (number and before is None):
                continue
            both = [LineView(fit, i, bool(r), views[r]) for r in (0, 1)]
            ends_px = [uv[[0, -1]] for uv in site.picked[name].views_px]
            line = locate_both(both, ends_px, before, config)
            if line is not None:
                found[name] = line
        found = dict(clicks_where_unresolved(fit, site.picked, found, config.clicked_sigmas))
    return fit, found


def _with_found(site: Site, found: Found) -> Site:
    """Return a site with the found lines in place of the clicked ones."""
    return replace(site, lines={**site.lines, **{
        name: PickedLine(name, left.uv_px, right.uv_px, left.std_px, right.std_px)
        for name, (left, right) in found.items()}})


def _checked(site: Site, first: Optional[RoadFit], views: tuple[Background, Background],
             found: Found, config: RefineConfig, prior: RoadPrior) -> _Checked:
    """
    Decide by the lines and the background whether the right camera has rotated.

    Points far off the road that the other points make are dropped.
    """
    if first is None:
        return _Checked(decide_drift(
            [FamilyDrift(0.0, np.zeros(3), _UNKNOWN_RAD2)], config, prior), None, None, found)
    rig = first.problem.rig
    epipolar = epipolar_check(rig, views, first.plane, config)
    information = np.linalg.inv(_UNKNOWN_RAD2)
    mean = np.zeros(3)
    if epipolar is not None:
        information = information + epipolar.information
        mean = np.linalg.solve(information, epipolar.information @ epipolar.drift_rad)
    before = DriftPrior(mean, np.linalg.cholesky(information).T)
    still = DriftPrior.loose(np.radians(max(prior.calibrated_std_deg, _LEAST_STILL_DEG)))
    clicked, site, kept = site, _with_found(site, found), found
    free = fit_lines(site, rig, first.names, before, prior, first)
    for _ in range(_STRAY_ROUNDS):
        without = _without_unclicked(clicked, free, without_strays(free, kept, config), config)
        if without == kept:
            break
        kept = without
        site = _with_found(clicked, kept)
        free = fit_lines(site, rig, first.names, before, prior, free)
    fixed = fit_lines(site, rig, first.names, still, prior, first)
    optima = _optima([fixed, free], before)
    drift = decide_drift(_drift_of(optima), config, prior)
    if drift.moved_probability > _DOUBTFUL:
        # Beside the best road for a camera that stands still, it may seem to have turned, and the
        # other way round.
        anew = _fitted_anew(site, rig, first.names, (still, before), prior)
        fixed = max([fixed, *anew[:1]], key=log_probability)
        drift = decide_drift(_drift_of(_optima(anew, before, optima)), config, prior)
    worst = int(np.argmax(np.abs(drift.drift_rad)))
    if np.degrees(abs(drift.drift_rad[worst])) > config.most_drift_deg:
        raise SiteError(site.where, f'{("pan", "tilt", "roll")[worst]} of the right camera since '
                        'its calibration', f'{np.degrees(drift.drift_rad[worst]):+.3f} degrees',
                        f'at most {config.most_drift_deg}; calibrate again')
    return _Checked(drift, epipolar, free if drift.moved else fixed, kept)


def _fitted_anew(site: Site, rig: StereoRig, names: Sequence[str], priors: Sequence[DriftPrior],
                 prior: RoadPrior) -> list[RoadFit]:
    """
    Return roads of found lines that do not start from the road along which these were found.

    The fit has local optima, and which one it ends in depends on where it starts.

    :param priors: priors of the rotation of the right camera.  The first road is fitted from a
        guess of its own, each other one from that before it.
    :return: a road for each prior; none if the guess fails.
    """
    fits: list[RoadFit] = []
    with suppress(SiteError):
        for drift in priors:
            fits.append(fit_lines(site, rig, names, drift, prior, fits[-1] if fits else None))
    return fits


def _optima(roads: Sequence[RoadFit], before: DriftPrior, known: Sequence[RoadFit] = ()
            ) -> list[RoadFit]:
    """
    Return the best fit of each plausible family of roads, with a camera that may have rotated.

    One family may have several optima, which all count.  Of fits that ended in one optimum, the
    most probable one does.

    :param roads: best roads if the camera may have rotated and if it stands as calibrated, from
        one start or more, with their rivals.
    :param before: prior of the rotation from the background.
    :param known: optima found already, of the same picks.
    """
    fits = list(known)
    for road, family in ((road, family) for road in roads for family in road.families):
        fit = in_family(road, family, before)
        same = next((k for k, other in enumerate(fits) if _is_same(fit, other)), None)
        if same is None:
            fits.append(fit)
        elif log_probability(fit) > log_probability(fits[same]):
            fits[same] = fit
    return fits


def _drift_of(fits: Sequence[RoadFit]) -> list[FamilyDrift]:
    """Return the rotation of the right camera by each fit, with the evidence for the fit."""
    return [FamilyDrift(log, fit.drift_rad, fit.covariance[-3:, -3:])
            for log, fit in zip(log_evidences(fits), fits)]


def _is_same(fit: RoadFit, other: RoadFit) -> bool:
    """Return whether two fits of the same picks are of one family, and end in one optimum."""
    if fit.problem.model.shape != other.problem.model.shape or (
            (fit.problem.wander is None) != (other.problem.wander is None)):
        return False
    apart = fit.drift_rad - other.drift_rad
    return bool(apart @ np.linalg.solve(fit.covariance[-3:, -3:], apart) < _SAME_OPTIMUM)


def _without_unclicked(clicked: Site, road: RoadFit, found: Found, config: RefineConfig) -> Found:
    """
    Return the found lines without those that cannot be the clicked ones.

    If something else was found beside the clicks, the clicked marking is hard to see.

    :param clicked: site with the lines as clicked.
    :param road: road fitted to the found lines.
    """
    distances = {name: ClickDistance.of(road, name, found[name][0].shape.width_m,
                                        clicked.picked[name].views_px,
                                        [view.uv_px[~view.is_clicked] for view in found[name]])
                 for name in road.names if name in found}
    unclicked = not_clicked(distances, road.problem.prior.pick_std_px, config.clicked_sigmas)
    return {name: line for name, line in found.items() if name not in unclicked}


def _with_ends(line: PickedLine, rough: PickedLine, road: RoadFit) -> PickedLine:
    """
    Return a line extrapolated to its clicked ends, where its lane's path has to end.

    Ends that are no longer in view are left out.
    """
    stds = line.views_std_px
    if stds is None:
        return line
    number, points, sigmas = road.number(line.name), [], []
    cameras = road.problem.rig.left, road.problem.rig.right
    for right, (uv, std) in enumerate(zip(line.views_px, stds)):
        feet = road.foot(number, bool(right), rough.views_px[right][[0, -1]])
        ends = road.seen(road.points(number, feet, np.zeros(2)), bool(right))
        in_view = may_be_picked(cameras[right], ends)
        for end in (0, -1):
            added = in_view[end] and np.linalg.norm(ends[end] - uv[end]) > _END_PX
            if added and _beyond(uv, ends[end], end):
                at = 0 if end == 0 else len(uv)
                uv = np.insert(uv, at, ends[end], axis=0)
                std = np.insert(std, at, _END_STD_PX)
        points.append(uv)
        sigmas.append(std)
    return PickedLine(line.name, *points, *sigmas)


def _beyond(uv: Array, point: Array, end: int) -> bool:
    """Return whether a point lies beyond the first (0) or the last (-1) point of a line."""
    outward = uv[0] - uv[1] if end == 0 else uv[-1] - uv[-2]
    return bool((point - uv[end]) @ outward > 0)
