# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The lane paths of a site."""
from __future__ import annotations

from dataclasses import replace
import math
from typing import Iterable, Mapping, Optional

import numpy as np
from numpy.typing import NDArray

from .extras import as_calibrated
from .file import LaneSpec, LEAST_ROAD_M, PickedLine, Site, SurveyedLine, VIEWS
from ..core.errors import SiteError
from ..core.records import Array
from ..geometry.camera import Camera
from ..geometry.rig import StereoRig
from ..road.curve_matching import match_curves
from ..road.first_guess import NoRoadError
from ..road.fit import fit_road, reach_m
from ..road.fitted import RoadFit
from ..road.lanes import lane_of_paths, lane_of_road, LanePath
from ..road.path import CAMERA_UP, Path, SplinePath
from ..road.problem import DriftPrior, RoadPrior
from ..road.scale import with_scale

MARGIN_PX = 5.0  # distance by which picks may lie outside the image, because of their scatter
_CLEAR_SHARE = 0.3  # relative difference of distances between line ends that tells the direction
ALIKE_PX = 2.0  # residual from which the lines are not taken as one road
MOST_RESIDUAL_PX = 5.0  # residual from which the two views do not show one line
_SAME_PX = 3.0  # distance up to which scatter may reverse the order of two picks


def lane_paths(site: Site, rig: StereoRig, prior: RoadPrior = RoadPrior()
               ) -> dict[str, LanePath]:
    """
    Return the path of every lane of a site, by name.

    All picked lines are fitted together as parallel lines of one road; if the residuals show that
    they are not, the lines of each lane are fitted separately. Lines of lanes in the opposite
    direction are reversed for the fit, and the paths of these lanes are reversed back.

    :param rig: rig with the site's correction applied.
    :param prior: prior knowledge of any road and rig.
    :raises SiteError: the picks give no usable road.
    """
    if not site.fits(rig):
        raise SiteError(site.where, 'rig_correction', 'a rig without it',
                        'the rig that corrected_rig returns')
    drift = site.correction or as_calibrated(prior)
    site, reversed_lines = in_one_direction(site, rig)
    joint = fit_lines(site, rig, site.picked, prior=prior) if site.picked else None
    if joint is not None and not joint.residual_px.max() < ALIKE_PX:
        joint = None
    out = {}
    for i, spec in enumerate(site.lanes):
        picked = tuple(n for n in spec.lines if n in site.picked)
        if picked:
            fit = joint or fit_lines(site, rig, picked, prior=prior)
            lane = _lane_on(fit, site, i, reversed_lines, prior)
        else:
            lane = _part_surveyed(site, spec, {}, rig, prior)
        lane = replace(lane, shape_std=math.hypot(lane.shape_std, spec.path_std))
        out[spec.name] = with_scale(lane, rig, drift.covariance_rad2)
    return out


def in_one_direction(site: Site, rig: StereoRig) -> tuple[Site, set[str]]:
    """
    Return a site whose picked lines all run like the first one, and the names of the reversed.

    Lines of one road that are clicked over the same stretch begin near one another.  For other
    lines the direction in space decides, because in the image parallel lines diverge towards the
    camera, by more than a right angle beside a wide road.

    :raises SiteError: picks outside the images.
    """
    picked = site.picked
    for line in picked.values():
        _refuse_outside(site, line, rig)
    first = next(iter(picked.values()), None)
    names = {n for n, line in picked.items()
             if first is not None and _is_opposed(line, first, rig)}
    return with_reversed(site, names), names


def _is_opposed(line: PickedLine, other: PickedLine, rig: StereoRig) -> bool:
    """Return whether two lines run in opposite directions."""
    ends, others = line.left_px[[0, -1]], other.left_px[[0, -1]]
    along, across = (float(np.linalg.norm(ends - other_ends, axis=1).sum())
                     for other_ends in (others, others[::-1]))
    if abs(along - across) > _CLEAR_SHARE * max(along, across):
        return across < along
    return float(_rough_vector(line, rig) @ _rough_vector(other, rig)) < 0


def with_reversed(site: Site, names: Iterable[str]) -> Site:
    """
    Return a site with some of its picked lines reversed.

    :param names: names of these lines.
    """
    return replace(site, lines={**site.lines, **{n: site.picked[n].in_reverse() for n in names}})


def _rough_vector(line: PickedLine, rig: StereoRig) -> Array:
    """Return the rough vector (3,) from the begin to the end of a line, by matching its picks."""
    points = match_curves(rig, line.left_px, line.right_px).points_m
    if len(points) < 2:
        return np.append(line.left_px[-1] - line.left_px[0], 0.0)
    return np.asarray(points[-1] - points[0])


def fit_lines(site: Site, rig: StereoRig, names: Iterable[str],
              drift: Optional[DriftPrior] = None, prior: RoadPrior = RoadPrior(),
              near: Optional[RoadFit] = None) -> RoadFit:
    """
    Return a road fitted to the named lines.

    :param site: site whose lines all run the same way; see :func:`in_one_direction`.
    :param names: names of picked lines.
    :param drift: prior of the drift of the right camera; None if it stands as calibrated.
    :param prior: prior knowledge of any road.
    :param near: approximate road of the same lines to start from.
    :raises SiteError: the picks give no usable road.
    """
    lines = [site.picked[n] for n in names]
    try:
        return fit_road(rig, {line.name: line.views_px for line in lines}, _stds(lines), drift,
                        prior, near=near)
    except (NoRoadError, np.linalg.LinAlgError) as error:
        raise SiteError(site.where, 'lines', error, 'picks of one line in both views') from None


def fit_roads(site: Site, rig: StereoRig, drift: Optional[DriftPrior], prior: RoadPrior
              ) -> list[RoadFit]:
    """Return the roads of the picked lines: one road if they fit it, else one per lane."""
    if not site.picked:
        return []
    fit = fit_lines(site, rig, site.picked, drift, prior)
    if fit.residual_px.max() < ALIKE_PX or not site.lanes:
        return [fit]
    lanes = [[n for n in lane.lines if n in site.picked] for lane in site.lanes]
    return [fit_lines(site, rig, names, drift, prior) for names in lanes if names]


def _stds(lines: Iterable[PickedLine]) -> dict[str, tuple[Array, Array]]:
    """Return the 1-sigmas of the lines that have them."""
    stds = {line.name: line.views_std_px for line in lines}
    return {name: std for name, std in stds.items() if std is not None}


def _lane_on(fit: RoadFit, site: Site, index: int, reversed_lines: set[str],
             prior: RoadPrior) -> LanePath:
    """Return a lane with at least one line on a fitted road."""
    spec = site.lanes[index]
    picked = tuple(n for n in spec.lines if n in site.picked)
    reverse = bool(reversed_lines.intersection(picked))
    if reverse and not reversed_lines.issuperset(picked):
        raise SiteError(site.where, f'lanes[{index}]', f'{picked[0]} opposed to {picked[1]}',
                        'picks in order along travel')
    _check_fit(site, fit, picked)
    if len(picked) < len(spec.lines):
        on_road = {n: lane_of_road(n, fit, (fit.number(n),), None, reverse=reverse)
                   for n in picked}
        return _part_surveyed(site, spec, on_road, fit.problem.rig, prior)
    numbers = tuple(fit.number(n) for n in picked)
    _refuse_swapped(site, index, fit, numbers[::-1] if reverse else numbers)
    return lane_of_road(spec.name, fit, numbers, spec.speed_limit_mps, reverse=reverse)


def _part_surveyed(site: Site, spec: LaneSpec, on_road: Mapping[str, LanePath],
                   rig: StereoRig, prior: RoadPrior) -> LanePath:
    """
    Return a lane with at least one surveyed line.

    :param on_road: paths along its picked lines, by name.
    """
    paths = {n: lane.path for n, lane in on_road.items()}
    surveyed = {n: line for n, line in site.lines.items()
                if isinstance(line, SurveyedLine) and n in spec.lines}
    paths.update({n: SplinePath(line.points_m) for n, line in surveyed.items()})
    std_m = max(prior.survey_std_m if line.std_m is None else line.std_m
                for line in surveyed.values())
    ordered = tuple(paths[n] for n in spec.lines)
    if len(ordered) == 2:
        _refuse_crossed(site, spec, *ordered)
    return lane_of_paths(spec.name, ordered, spec.speed_limit_mps, rig, std_m,
                         list(on_road.values()))


def _refuse_crossed(site: Site, spec: LaneSpec, right: Path, left: Path) -> None:
    """Refuse lines of which one is surveyed, if they are opposed or on each other's side."""
    short = min(right, left, key=lambda path: path.length_m)
    here = short.position(np.array([short.length_m / 2]))  # where there are both
    at_right, at_left = right.arc_length(here), left.arc_length(here)
    on_right, on_left = right.position(at_right), left.position(at_left)
    tangent, other = right.tangent(at_right)[0], left.tangent(at_left)[0]
    where = f'lanes[{site.lanes.index(spec)}]'
    if not tangent @ other > 0:
        raise SiteError(site.where, where, f'{spec.right} opposed to {spec.left}',
                        'points in order along travel')
    if not np.cross(tangent, (on_left - on_right)[0]) @ CAMERA_UP > 0:
        raise SiteError(site.where, f'{where}.right', f'{spec.right}, left of {spec.left}',
                        "the line on the driver's right, with points in order along travel")


def may_be_picked(camera: Camera, uv_px: Array) -> NDArray[np.bool_]:
    """Return which raw pixels (n, 2) lie in the image, or 5 px beyond it, and have a ray."""
    size = np.array([camera.width_px, camera.height_px])
    inside = ((uv_px >= -MARGIN_PX) & (uv_px <= size - 1 + MARGIN_PX)).all(axis=-1)
    return np.asarray(inside & np.isfinite(camera.undistort(uv_px)).all(axis=-1))


def _refuse_outside(site: Site, line: PickedLine, rig: StereoRig) -> None:
    """Refuse picks outside the image, or for which the lens has no ray."""
    for view, camera, uv in zip(VIEWS, (rig.left, rig.right), line.views_px):
        bad = ~may_be_picked(camera, uv)
        if bad.any():
            i = int(np.argmax(bad))
            raise SiteError(site.where, f'lines.{line.name}.{view}[{i}]', uv[i].tolist(),
                            f'a pixel of the {camera.width_px}x{camera.height_px} image')


def _check_fit(site: Site, fit: RoadFit, names: tuple[str, ...]) -> None:
    """Refuse a lane's lines if they fit badly, run backwards or are too short."""
    picks, ranges = fit.problem.picks, []
    for name in names:
        number, where = fit.number(name), f'lines.{name}'
        if not fit.residual_px[number] < MOST_RESIDUAL_PX:
            raise SiteError(site.where, where, f'picks {fit.residual_px[number]:.1f} px off',
                            f'views that agree within {MOST_RESIDUAL_PX} px')
        for right, view in enumerate(VIEWS):
            rows = picks.of_line(number, bool(right))
            apart = np.linalg.norm(np.diff(picks.uv_px[rows], axis=0), axis=-1)
            at_m = fit.feet.s_m[rows]
            known = np.abs(at_m) < reach_m(fit)
            back = (np.diff(at_m) <= 0) & (apart > _SAME_PX) & (known[1:] | known[:-1])
            # Where a crest hides the road its length, and so the order of picks, is not known.
            # Points found in the images are in order, but may not appear so at a crest.
            if back.any() and site.picked[name].views_std_px is None:
                raise SiteError(site.where, f'{where}.{view}[{int(np.argmax(back)) + 1}]',
                                'a pick behind the previous one', 'picks in order along travel')
        ranges.append(fit.line_range_m(number))
    common = min(b for _, b in ranges) - max(a for a, _ in ranges)
    if common < LEAST_ROAD_M:
        raise SiteError(site.where, 'lines.' + ' and '.join(names), f'{max(common, 0.0):.1f} m',
                        f'at least {LEAST_ROAD_M} m of road in common')


def _refuse_swapped(
        site: Site, index: int, fit: RoadFit, numbers: tuple[int, ...]) -> None:
    """Refuse a lane whose right line lies to the left of its left line."""
    offsets = fit.problem.model.offsets(fit.x)[list(numbers)]
    if len(numbers) == 2 and not offsets[1] > offsets[0]:
        lane = site.lanes[index]
        raise SiteError(site.where, f'lanes[{index}].right', f'{lane.right}, left of {lane.left}',
                        "the line on the driver's right, with picks in order along travel")
