# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""From a mark in both views to a front on the path with its depth."""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .front import back_project, Front
from .likelihood import sample_quads
from .observation import inside
from ..core.errors import InputError
from ..core.records import Array, StereoPair
from ..geometry.rig import StereoRig
from ..road.path import Path
from ..site.file import InitialFront
from ..vision.haar import PartGrid
from ..vision.ncc import ncc

_MAX_GAP_PX = 5.0  # marks whose centres' rays pass further apart are of different things
_SEARCH_SIGMAS = 4.0
_SEARCH_STEP_PX = 0.2  # step of the depth search, in disparity
_INDEPENDENT = 0.35  # share of independent samples in a patch
_TIME_STEPS = 4  # to bring two marks of different times together
_MIN_NCC = 0.5  # views of the same front agree better than this


@dataclass(frozen=True, eq=False)
class Placement:
    """
    A front found in its first pair.

    :param front: the front, its corners taken from the left mark.
    :param pose: (3,) s, a, b, m.
    :param s_std_m: 1-sigma of s from the marks alone, m.
    :param offset_slope: (2,) change of a and b per metre of s along the centre's ray.
    :param disparity_slope: change of the disparity per metre of s, px/m.
    :param cross_ncc: left-right NCC at the pose.
    """

    front: Front
    pose: Array
    s_std_m: float
    offset_slope: Array
    disparity_slope: float
    cross_ncc: float


def check_mark(rig: StereoRig, mark: InitialFront, where: str) -> None:
    """
    Check that a mark lies in both images.

    :raises InputError: names the side.
    """
    for side, camera, quad in (('left_image', rig.left, mark.left_px),
                               ('right_image', rig.right, mark.right_px)):
        if not inside(camera, quad):
            raise InputError(where, f'vehicles: frame {mark.frame}: {side}',
                             np.round(quad, 1).tolist(),
                             f'corners inside the {camera.width_px}x{camera.height_px} image')


def place_front(rig: StereoRig, path: Path, mark: InitialFront, pair: StereoPair, grid: PartGrid,
            later_m: float = 0.0) -> Placement:
    """
    Place the marked front on the path.

    The marks give the depth to a few per cent; along the ray of the left mark the left-right
    NCC then says where the right view really agrees.

    :param later_m: how far it goes until the right view is exposed, by its expected speed, m.
    :raises InputError: the marks do not triangulate in front of the rig, or the views disagree.
    """
    where = f'pair {pair.index}: init mark'
    if later_m:
        mark = _at_one_time(rig, path, mark, later_m)
    # Far corners triangulate metres apart in depth; the mean of the pixels does not mind.
    centre = rig.triangulate(mark.left_px.mean(axis=0), mark.right_px.mean(axis=0))
    if not np.isfinite(centre).all() or centre[2] <= 0:
        raise InputError(where, 'left and right quads', 'no point in front of the cameras',
                         'quads on the same vehicle front')
    left, right, _, _ = rig.project(centre[None])
    gap_px = float(np.linalg.norm(right[0] - mark.right_px.mean(axis=0))
                   + np.linalg.norm(left[0] - mark.left_px.mean(axis=0)))
    if not gap_px < _MAX_GAP_PX:
        raise InputError(where, 'left and right quads', f'{gap_px:.1f} px off one another',
                         f'quads of one vehicle front, within {_MAX_GAP_PX:.0f} px of the '
                         f'epipolar line')
    s_mark = float(path.arc_length(centre))
    uv = mark.left_px.mean(axis=0, keepdims=True)

    def disparity(s_m: float) -> float:
        xy = back_project(path, rig.left, s_m, uv)
        point = path.position(np.array(s_m)) + path.frame(np.array(s_m))[:, 1:] @ xy[0]
        left, right, _, _ = rig.project(point[None])
        return float(left[0, 0] - right[0, 0])

    slope = disparity(s_mark + 0.5) - disparity(s_mark - 0.5)
    s_std = mark.std_px * np.sqrt(2 / len(mark.left_px)) / abs(slope)
    candidates = s_mark + np.arange(
        -_SEARCH_SIGMAS * s_std, _SEARCH_SIGMAS * s_std, _SEARCH_STEP_PX / abs(slope))
    scores = _cross_scores(rig, path, mark, pair, grid, candidates, later_m)
    spread = (candidates - s_mark) / s_std
    samples = _INDEPENDENT * grid.unit_xy.shape[0]
    log_post = -0.5 * samples * np.log(np.maximum(1 - scores, 1e-3)) - 0.5 * spread ** 2
    best = int(np.argmax(log_post))
    if not scores[best] > _MIN_NCC:
        raise InputError(where, 'left-right correlation', f'{scores[best]:.2f}',
                         f'above {_MIN_NCC}: quads on the same vehicle front')
    s_m = float(candidates[best])
    quad = back_project(path, rig.left, s_m, mark.left_px)
    offset = quad.mean(axis=0)
    slope_ab = back_project(path, rig.left, s_m + 0.5, uv)[0] \
        - back_project(path, rig.left, s_m - 0.5, uv)[0]
    return Placement(Front(path, quad - offset), np.array([s_m, *offset]), float(s_std),
                       slope_ab, float(slope), float(scores[best]))


def _at_one_time(rig: StereoRig, path: Path, mark: InitialFront, later_m: float) -> InitialFront:
    """Move a right mark that is of a later time to where it was at that of the left one."""
    right = mark.right_px
    for _ in range(_TIME_STEPS):
        centre = rig.triangulate(mark.left_px.mean(axis=0), right.mean(axis=0))
        if not np.isfinite(centre).all():
            break  # refused with its reason
        s_m = path.arc_length(centre)
        ahead = centre + path.position(s_m + later_m) - path.position(s_m)
        right = mark.right_px - (rig.project(ahead)[1] - rig.project(centre)[1])
    return replace(mark, right_px=right)


def _cross_scores(rig: StereoRig, path: Path, mark: InitialFront, pair: StereoPair,
                  grid: PartGrid, candidates: Array, later_m: float) -> Array:
    """Left-right NCC with the left quad fixed and the plane at each candidate s."""
    quads = np.stack([
        rig.project(path.position(np.array(s + later_m))
                    + back_project(path, rig.left, s, mark.left_px)
                    @ path.frame(np.array(s + later_m))[:, 1:].T)[1]
        for s in candidates])
    left = sample_quads(pair.left, mark.left_px[None], grid)
    scores = np.zeros(len(candidates))
    seen = np.isfinite(quads).all(axis=(1, 2))  # others lie behind the right camera
    if seen.any():
        scores[seen] = ncc(sample_quads(pair.right, quads[seen], grid), left[0])
    return scores
