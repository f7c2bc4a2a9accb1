# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""From a mark in both views to a front on the path with its depth."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Union

import numpy as np

from .front import back_project, Front
from .likelihood import sample_quads
from .observation import inside, lag_s
from .protocol import Refusal, TrackStart
from ..core.errors import InputError
from ..core.records import Array, InitialFront, StereoPair
from ..geometry.rig import StereoRig
from ..road.path import Path
from ..vision.haar import PartGrid
from ..vision.ncc import ncc

_SEARCH_STEP_PX = 0.2  # step of the depth search, in disparity
_TIME_STEPS = 4  # to bring two marks of different times together


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


def check_annotation(rig: StereoRig, front: InitialFront, where: str) -> None:
    """
    Check that an annotated front lies in both images.

    :raises InputError: names the side.
    """
    for side, camera, quad in (('left_image', rig.left, front.left_px),
                               ('right_image', rig.right, front.right_px)):
        if not inside(camera, quad):
            raise InputError(where, f'vehicles: frame {front.frame}: {side}',
                             np.round(quad, 1).tolist(),
                             f'corners inside the {camera.width_px}x{camera.height_px} image')


def place_front(start: TrackStart, grid: PartGrid) -> Union[Placement, Refusal]:
    """
    Return where the first front stands on the path, or why it is none.

    The quads give the depth to a few per cent; along the ray of the left one the left-right NCC
    then says where the right view really agrees.

    :param start: what the track starts from.
    :param grid: samples of the front.
    """
    rig, path, front, pair = start.rig, start.lane.path, start.front, start.pair
    limits, where = start.config.start, f'pair {pair.index}: init mark'
    # How far the vehicle goes until the right view is exposed.
    later_m = start.expected_mps * lag_s(pair, start.config.trigger_tolerance_s)
    if later_m:
        front = _at_one_time(rig, path, front, later_m)
    # Far corners triangulate metres apart in depth; the mean of the pixels does not mind.
    centre = rig.triangulate(front.left_px.mean(axis=0), front.right_px.mean(axis=0))
    if not np.isfinite(centre).all() or centre[2] <= 0:
        return Refusal(where, 'left and right quads', 'no point in front of the cameras',
                       'quads on the same vehicle front')
    left, right, _, _ = rig.project(centre[None])
    gap_px = float(np.linalg.norm(right[0] - front.right_px.mean(axis=0))
                   + np.linalg.norm(left[0] - front.left_px.mean(axis=0)))
    if not gap_px < limits.most_gap_px:
        return Refusal(where, 'left and right quads', f'{gap_px:.1f} px off one another',
                       f'quads of one vehicle front, within {limits.most_gap_px:g} px of the '
                       'epipolar line')
    s_mark = float(path.arc_length(centre))
    uv = front.left_px.mean(axis=0, keepdims=True)

    def disparity(s_m: float) -> float:
        xy = back_project(path, rig.left, s_m, uv)
        point = path.position(np.array(s_m)) + path.frame(np.array(s_m))[:, 1:] @ xy[0]
        left, right, _, _ = rig.project(point[None])
        return float(left[0, 0] - right[0, 0])

    slope = disparity(s_mark + 0.5) - disparity(s_mark - 0.5)
    s_std = front.std_px * np.sqrt(2 / len(front.left_px)) / abs(slope)
    candidates = s_mark + np.arange(
        -limits.search_sigmas * s_std, limits.search_sigmas * s_std, _SEARCH_STEP_PX / abs(slope))
    scores = _cross_scores(rig, path, front, pair, grid, candidates, later_m)
    spread = (candidates - s_mark) / s_std
    samples = start.config.noise.independent_share * grid.unit_xy.shape[0]
    log_post = -0.5 * samples * np.log(np.maximum(1 - scores, 1e-3)) - 0.5 * spread ** 2
    best = int(np.argmax(log_post))
    if not scores[best] > limits.least_ncc:
        return Refusal(where, 'left-right correlation', f'{scores[best]:.2f}',
                       f'above {limits.least_ncc}: quads on the same vehicle front')
    s_m = float(candidates[best])
    quad = back_project(path, rig.left, s_m, front.left_px)
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
