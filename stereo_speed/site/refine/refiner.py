# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
From a rough site and some pairs of images to a site known to a few hundredths of a pixel.

The rough clicks give a road; along it the paint is found in both raw views; all points of all
lines give a better road, and so once more. Together with the details of the background the
points then tell whether the right camera has turned since its calibration.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Iterable, Mapping, Optional

import numpy as np

from .cross_sections import SplineImage
from .empty_road import Background, backgrounds
from .extrinsic_drift import judged, MOST_TURN_DEG, Turn
from .markings import locate, LocatedLine
from .rig_check import Epipolar, epipolar_check
from ..extras import RigCorrection
from ..file import Site, SiteLine
from ..lane_paths import (
    ALIKE_PX, fit_lines, lane_paths, one_way, picked_names, picks_of, turned_line)
from ...core.errors import SiteError
from ...core.records import Array, StereoPair
from ...geometry.rig import StereoRig
from ...road.fit import RoadFit, same_family
from ...road.lanes import LanePath
from ...road.problem import RoadProblem, TurnPrior

ROUNDS = 2
_LOOSE_RAD = np.radians(0.2)  # how far the camera may have turned while the paint is looked for
_UNBOUND_RAD = np.radians(1.0)
_END_STD_PX = 1.0  # of the ends of lines, which carry on what lies before them
_END_PX = 4.0
_FAR_SIGMAS, _MOST_DROPPED = 5.0, 0.3

Found = dict[str, tuple[LocatedLine, LocatedLine]]


@dataclass(frozen=True, eq=False)
class RefinedSite:
    """
    A refined site, and how it came about.

    :param site: with the refined points, their 1-sigmas and the correction of the rig.
    :param rig: the rig as it stands now; what measures takes this one.
    :param lanes: paths of all lanes, with that rig.
    :param rough: the site it came from.
    :param found: what was found of each line in the left and in the right view.
    :param lost: names of lines of which nothing was found; they stay as they were clicked.
    :param road: the road that the lines of the largest group make, with the corrected rig.
    :param road_lines: names of its lines, in its order.
    :param turn: what is known of a turn of the right camera.
    :param epipolar: what the background says of it; None without details.
    :param views: clean images of both views.
    """

    site: Site
    rig: StereoRig
    lanes: dict[str, LanePath]
    rough: Site
    found: Mapping[str, tuple[LocatedLine, LocatedLine]]
    lost: tuple[str, ...]
    road: Optional[RoadFit]
    road_lines: tuple[str, ...]
    turn: Turn
    epipolar: Optional[Epipolar]
    views: tuple[Background, Background]


def refine_site(site: Site, rig: StereoRig, pairs: Iterable[StereoPair]) -> RefinedSite:
    """
    Refine a site from the images themselves.

    :param site: rough or refined before; lines that are surveyed stay as they are.
    :param rig: as calibrated, or as the site corrects it.
    :param pairs: a few or many, spread over the time that the site is used in.
    :raises SiteError: when the rough lines leave no usable road, or the camera has turned too far.
    :raises InputError: without pairs.
    """
    views = backgrounds(pairs, site.where)
    if any(rig.turn_rad):
        rig = rig.turned(-np.array(rig.turn_rad))
    plain = replace(site, correction=None)
    one, against = one_way(plain, rig)
    images = SplineImage(views[0].image), SplineImage(views[1].image)
    found: Found = {}
    fits = {}
    for names, rough in _groups(one, rig):
        fits[names] = _find(one, (rig, names, rough), images, views, found)
    names = max(fits, key=len, default=())
    turn, epipolar, road = _turn(one, (rig, names, fits.get(names)), views, found)
    correction = RigCorrection(turn.turn_rad, turn.covariance_rad2)
    better = replace(_with_found(one, found), correction=correction if names else None)
    now = better.corrected_rig(rig)
    if road is not None:
        road = same_family(road, RoadProblem(now, road.problem.picks, road.problem.model))
    ended = replace(better, lines={n: _with_ends(line, one.lines[n], found.get(n), road, names)
                                   for n, line in better.lines.items()})
    result = replace(ended, lines={n: turned_line(line) if n in against else line
                                   for n, line in ended.lines.items()})
    lost = tuple(n for n in picked_names(site) if n not in found)
    return RefinedSite(result, now, lane_paths(result, now), site, found, lost, road, names, turn,
                       epipolar, views)


def _groups(site: Site, rig: StereoRig) -> list[tuple[tuple[str, ...], RoadFit]]:
    """Group the picked lines by the roads they are of: one if they fit one, else lane by lane."""
    picked = picked_names(site)
    if not picked:
        return []
    loose = TurnPrior.loose(_LOOSE_RAD)
    fit = fit_lines(site, rig, picked, loose)
    if fit.residual_px.max() < ALIKE_PX:
        return [(picked, fit)]
    lanes = [tuple(n for n in lane.lines if n in picked) for lane in site.lanes]
    return [(mine, fit_lines(site, rig, mine, loose)) for mine in lanes if mine]


def _find(site: Site, road: tuple[StereoRig, tuple[str, ...], RoadFit],
          images: tuple[SplineImage, SplineImage], views: tuple[Background, Background],
          found: Found) -> RoadFit:
    """Find the lines of one road in both views, all into ``found``; give a better road."""
    rig, names, fit = road
    mine = [name for name in names if name not in found]
    for number in range(ROUNDS):
        if number:
            fit = fit_lines(_with_found(site, found), rig, names, TurnPrior.loose(_LOOSE_RAD))
        for i, name in enumerate(names):
            if name not in mine or (number and name not in found):
                continue
            before = found.get(name)
            ends = site.lines[name].left_px[[0, -1]], site.lines[name].right_px[[0, -1]]
            located = [locate(fit, images[r], i, bool(r), ends[r], views[r].noise_grey,
                              before[r].shape if before else None) for r in (0, 1)]
            if located[0] is not None and located[1] is not None:
                found[name] = located[0], located[1]
    return fit


def _with_found(site: Site, found: Found) -> Site:
    """Put what was found in place of what was clicked."""
    return replace(site, lines={n: _refined(line, found.get(n))
                                for n, line in site.lines.items()})


def _refined(line: SiteLine, found: Optional[tuple[LocatedLine, LocatedLine]]) -> SiteLine:
    """Put what was found of one line in place of its clicks."""
    if found is None:
        return line
    left, right = found
    return replace(line, left_px=left.uv_px, right_px=right.uv_px, left_std_px=left.std_px,
                   right_std_px=right.std_px)


def _turn(site: Site, road: tuple[StereoRig, tuple[str, ...], Optional[RoadFit]],
          views: tuple[Background, Background], found: Found
          ) -> tuple[Turn, Optional[Epipolar], Optional[RoadFit]]:
    """
    Ask the lines and the background whether the right camera has turned.

    Stretches of ``found`` that lie off the road that the others make are dropped.
    """
    rig, names, first = road
    if first is None:
        return judged(np.zeros(3), np.eye(3) * _UNBOUND_RAD**2), None, None
    epipolar = epipolar_check(rig, (views[0].image, views[1].image), _plane(first))
    information = np.eye(3) / _UNBOUND_RAD**2
    mean = np.zeros(3)
    if epipolar is not None:
        information = information + epipolar.information
        mean = np.linalg.solve(information, epipolar.information @ epipolar.turn_rad)
    prior = TurnPrior(mean, np.linalg.cholesky(information).T)
    fit = fit_lines(_with_found(site, found), rig, names, prior)
    if _dropped(fit, names, found):
        lines = _with_found(site, found).lines
        fit = same_family(fit, RoadProblem(rig, picks_of([lines[n] for n in names]),
                                           fit.problem.model, prior))
    turn = judged(fit.turn_rad, fit.covariance[-3:, -3:])
    worst = int(np.argmax(np.abs(turn.turn_rad)))
    if np.degrees(abs(turn.turn_rad[worst])) > MOST_TURN_DEG:
        raise SiteError(site.where, f'{("pan", "tilt", "roll")[worst]} of the right camera since '
                        'its calibration', f'{np.degrees(turn.turn_rad[worst]):+.3f} degrees',
                        f'at most {MOST_TURN_DEG}; calibrate again')
    return turn, epipolar, fit


def _dropped(fit: RoadFit, names: tuple[str, ...], found: Found) -> bool:
    """Drop what is far off the road: a rail's edge, a shadow's. Never much of a line."""
    picks, any_dropped = fit.problem.picks, False
    off = np.abs(fit.feet.residual_px) / (picks.std_px * fit.scale)
    for number, name in enumerate(names):
        if name not in found:
            continue
        kept = []
        for right, line in enumerate(found[name]):
            mine = off[(picks.line == number) & (picks.right == bool(right))]
            good = mine < _FAR_SIGMAS
            few = good.sum() < max((1 - _MOST_DROPPED) * len(good), 3)
            kept.append(line if few else line.take(good))
            any_dropped |= not few and not good.all()
        found[name] = kept[0], kept[1]
    return any_dropped


def _plane(fit: RoadFit) -> tuple[Array, float]:
    """Give the plane (n, d) that a road lies in, about its middle."""
    points, frames = fit.problem.model.reference(fit.x)
    middle = len(points) // 2
    n = frames[middle, :, 2]
    d = float(n @ points[middle])
    return (n, d) if d > 0 else (-n, -d)


def _with_ends(line: SiteLine, rough: SiteLine, found: Optional[tuple[LocatedLine, LocatedLine]],
               road: Optional[RoadFit], names: tuple[str, ...]) -> SiteLine:
    """Carry a line on to where it was clicked to end: its lane's path ends there."""
    if found is None or road is None or line.name not in names:
        return line
    number, out = names.index(line.name), {}
    for right, side in enumerate(('left', 'right')):
        uv, std = getattr(line, f'{side}_px'), getattr(line, f'{side}_std_px')
        feet = road.foot(number, bool(right), getattr(rough, f'{side}_px')[[0, -1]])
        ends = road.seen(road.points(number, feet, np.zeros(2)), bool(right))
        for end, at in ((0, 0), (-1, len(uv))):
            if np.linalg.norm(ends[end] - uv[end]) > _END_PX and _beyond(uv, ends[end], end):
                uv = np.insert(uv, at if end == 0 else len(uv), ends[end], axis=0)
                std = np.insert(std, at if end == 0 else len(std), _END_STD_PX)
        out[f'{side}_px'], out[f'{side}_std_px'] = uv, std
    return replace(line, **out)


def _beyond(uv: Array, point: Array, end: int) -> bool:
    """Say whether a point lies beyond the first (0) or the last (-1) point of a line."""
    way = uv[0] - uv[1] if end == 0 else uv[-1] - uv[-2]
    return bool((point - uv[end]) @ way > 0)
