# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The lane paths that follow from a site."""
from __future__ import annotations

from dataclasses import replace
from typing import Mapping, Optional, Sequence

import numpy as np

from .extras import as_calibrated
from .file import LaneSpec, LEAST_ROAD_M, Site, SiteLine, VIEWS
from ..core.errors import SiteError
from ..core.records import Array
from ..geometry.rig import StereoRig
from ..road.curve_matching import match_curves
from ..road.fit import fit_road, RoadFit
from ..road.lanes import lane_of_paths, lane_of_road, LanePath, surveyed_path
from ..road.path import Path
from ..road.problem import Picks, TurnPrior
from ..road.scale import with_scale

MARGIN_PX = 5.0  # how far outside the image a pick may lie: scatter at the edge
ALIKE_PX = 2.0  # residual beyond which the lines are not taken for one road
MOST_RESIDUAL_PX = 5.0
_SAME_PX = 3.0  # picks nearer than this to each other may swap by their scatter


def lane_paths(site: Site, rig: StereoRig) -> dict[str, LanePath]:
    """
    Reconstruct the path of every lane of a site.

    All picked lines are taken for parallel lines of one road and fitted together; where they
    turn out not to be, each lane's lines are fitted by themselves. Lines of lanes in the other
    direction are turned round for the fit, and their lanes' paths back again.

    :raises SiteError: when the picks leave no usable road.
    """
    if not site.fits(rig):
        raise SiteError(site.where, 'rig_correction', 'a rig without it',
                        'the rig that corrected_rig gives')
    turned = site.correction or as_calibrated()
    site, against = one_way(site, rig)
    picked = picked_names(site)
    joint = fit_lines(site, rig, picked) if picked else None
    alike = joint is not None and joint.residual_px.max() < ALIKE_PX
    out = {}
    for i, lane in enumerate(site.lanes):
        mine = tuple(n for n in lane.lines if n in picked)
        fit, order = (joint, picked) if alike else (
            fit_lines(site, rig, mine) if mine else None, mine)
        away = bool(against.intersection(mine))
        if away and not against.issuperset(mine):
            raise SiteError(site.where, f'lanes[{i}]', f'{mine[0]} against {mine[1]}',
                            'picks in order along travel')
        if fit is not None and mine:
            _check_fit(site, fit, order, mine)
        if len(mine) == len(lane.lines):
            numbers = tuple(order.index(n) for n in mine)
            _refuse_swapped(site, i, fit, numbers[::-1] if away else numbers)
            out[lane.name] = lane_of_road(
                lane.name, fit, numbers, lane.speed_limit_mps, away=away)
        else:
            out[lane.name] = _mixed(site, lane, fit, order, away)
        out[lane.name] = with_scale(out[lane.name], rig, turned.covariance_rad2)
    return out


def picked_names(site: Site) -> tuple[str, ...]:
    """Name the lines that were picked, not surveyed."""
    return tuple(n for n, line in site.lines.items() if line.points_m is None)


def one_way(site: Site, rig: StereoRig) -> tuple[Site, set[str]]:
    """
    Turn picked lines round so that all run the way of the first one; name those turned.

    :raises SiteError: for picks outside the images.
    """
    picked = {n: site.lines[n] for n in picked_names(site)}
    for line in picked.values():
        _refuse_outside(site, line, rig)
    against = _against(picked, rig)
    return replace(site, lines={n: turned_line(line) if n in against else line
                                for n, line in site.lines.items()}), against


def _against(picked: Mapping[str, SiteLine], rig: StereoRig) -> set[str]:
    """
    Name the lines that run against the first one.

    In an image lines of one road diverge towards the camera, by more than a right angle beside
    a wide one; in space they do not.
    """
    ways = {n: _way(line, rig) for n, line in picked.items()}
    return {n for n, way in ways.items() if way @ next(iter(ways.values())) < 0}


def _way(line: SiteLine, rig: StereoRig) -> Array:
    """Return from where to where a line goes, (3,), as roughly as its picks match."""
    points = match_curves(rig, line.left_px, line.right_px).points_m
    if len(points) < 2:
        return np.append(line.left_px[-1] - line.left_px[0], 0.0)
    return points[-1] - points[0]


def turned_line(line: SiteLine) -> SiteLine:
    """Give a picked line in the other order."""
    values = {key: getattr(line, key) for key in (
        'left_px', 'right_px', 'left_std_px', 'right_std_px')}
    return replace(line, **{k: None if v is None else v[::-1] for k, v in values.items()})


def _mixed(site: Site, lane: LaneSpec, fit: Optional[RoadFit], order: tuple[str, ...],
           away: bool) -> LanePath:
    """Make a lane of which at least one line is surveyed."""
    paths: list[Path] = []
    residual = 0.0
    for name in lane.lines:
        points = site.lines[name].points_m
        if points is not None:
            paths.append(surveyed_path(points))
        else:
            one = lane_of_road(name, fit, (order.index(name),), None, away=away)
            paths.append(one.path)
            residual = one.residual_px
    return lane_of_paths(lane.name, tuple(paths), lane.speed_limit_mps, residual)


def _refuse_outside(site: Site, line: SiteLine, rig: StereoRig) -> None:
    """Refuse picks outside the image, or where the lens has no ray."""
    for view, camera, uv in ((VIEWS[0], rig.left, line.left_px),
                             (VIEWS[1], rig.right, line.right_px)):
        size = np.array([camera.width_px, camera.height_px])
        bad = ((uv < -MARGIN_PX) | (uv > size - 1 + MARGIN_PX)).any(axis=-1)
        bad |= ~np.isfinite(camera.undistort(uv)).all(axis=-1)
        if bad.any():
            i = int(np.argmax(bad))
            raise SiteError(site.where, f'lines.{line.name}.{view}[{i}]', uv[i].tolist(),
                            f'a pixel of the {camera.width_px}x{camera.height_px} image')


def _stds(lines: Sequence[SiteLine]) -> dict[str, tuple[Array, Array]]:
    """Give the 1-sigmas of the lines that have them."""
    return {line.name: (line.left_std_px, line.right_std_px) for line in lines
            if line.left_std_px is not None and line.right_std_px is not None}


def picks_of(lines: Sequence[SiteLine]) -> Picks:
    """
    Gather the picks of lines.

    :param lines: picked ones.
    """
    return Picks.of({line.name: (line.left_px, line.right_px) for line in lines}, _stds(lines))


def fit_lines(site: Site, rig: StereoRig, names: tuple[str, ...],
              turn: Optional[TurnPrior] = None) -> RoadFit:
    """
    Fit a road to the named lines.

    :param site: whose lines all run the same way; see :func:`one_way`.
    :param names: of picked lines.
    :param turn: what is known of a turn of the right camera; None for as calibrated.
    :raises SiteError: when the picks leave no usable road.
    """
    lines = {n: (site.lines[n].left_px, site.lines[n].right_px) for n in names}
    stds = _stds([site.lines[n] for n in names])
    try:
        return fit_road(rig, lines, stds, turn)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise SiteError(site.where, 'lines', error, 'picks of one line in both views') from None


def _check_fit(
        site: Site, fit: RoadFit, order: tuple[str, ...], mine: tuple[str, ...]) -> None:
    """Refuse a lane's lines if they fit badly, run backwards or are too short."""
    picks, ranges = fit.problem.picks, []
    for name in mine:
        number = order.index(name)
        where = f'lines.{name}'
        if not fit.residual_px[number] < MOST_RESIDUAL_PX:
            raise SiteError(site.where, where, f'picks {fit.residual_px[number]:.1f} px off',
                            f'views that agree within {MOST_RESIDUAL_PX} px')
        for right, view in enumerate(VIEWS):
            mask = (picks.line == number) & (picks.right == bool(right))
            apart = np.linalg.norm(np.diff(picks.uv_px[mask], axis=0), axis=-1)
            back = (np.diff(fit.feet.s_m[mask]) <= 0) & (apart > _SAME_PX)
            if back.any():
                raise SiteError(site.where, f'{where}.{view}[{int(np.argmax(back)) + 1}]',
                                'a pick behind the one before it', 'picks in order along travel')
        ranges.append(fit.line_range_m(number))
    common = min(b for _, b in ranges) - max(a for a, _ in ranges)
    if common < LEAST_ROAD_M:
        raise SiteError(site.where, 'lines.' + ' and '.join(mine), f'{max(common, 0.0):.1f} m',
                        f'at least {LEAST_ROAD_M} m of road in common')


def _refuse_swapped(
        site: Site, index: int, fit: RoadFit, numbers: tuple[int, ...]) -> None:
    """Refuse a lane whose right line lies to the left of its left line."""
    offsets = fit.problem.model.offsets(fit.x)[list(numbers)]
    if len(numbers) == 2 and not offsets[1] > offsets[0]:
        lane = site.lanes[index]
        raise SiteError(site.where, f'lanes[{index}].right', f'{lane.right}, left of {lane.left}',
                        "the line on the driver's right, with picks in order along travel")
