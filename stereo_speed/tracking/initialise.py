# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The start of a track: places a front, seen in both views, on the path; draws particles."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Union

import numpy as np

from .front import Front, onto_cross_plane
from .protocol import Refusal, TrackStart
from ..core.errors import InputError
from ..core.records import Array, InitialFront
from ..geometry.rig import StereoRig
from ..road.path import Path
from ..vision.haar import PartGrid
from ..vision.ncc import ncc
from ..vision.sampling import sample_quads

_SEARCH_STEP_PX = 0.2  # step of the depth search, in disparity
_TIME_STEPS = 4  # fixed-point iterations that refer two quads of different times to one time
_HALF_STEP_M = 0.5  # half step along the path of central differences


@dataclass(frozen=True, eq=False)
class Placement:
    """
    A front found in its first pair.

    :param front: the front, its corners taken from the left quad.
    :param pose: (3,) s, a, b, m.
    :param s_std_m: 1-sigma of s from the quads alone, m.
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


@dataclass(frozen=True)
class _Depth:
    """
    The depth that follows from two quads alone.

    :param s_m: arc length on the path, m.
    :param s_std_m: 1-sigma of the arc length, m.
    :param slope_px: change of the disparity per metre of arc length, px/m.
    """

    s_m: float
    s_std_m: float
    slope_px: float


def check_annotation(rig: StereoRig, front: InitialFront, where: str) -> None:
    """
    Check that an annotated front lies in both images.

    :raises InputError: it does not; the error names the view.
    """
    for side, camera, quad in (('left_image', rig.left, front.left_px),
                               ('right_image', rig.right, front.right_px)):
        if not camera.holds(quad):
            raise InputError(where, f'vehicles: frame {front.frame}: {side}',
                             np.round(quad, 1).tolist(),
                             f'corners inside the {camera.width_px}x{camera.height_px} image')


def place_front(start: TrackStart, grid: PartGrid) -> Union[Placement, Refusal]:
    """
    Return the place of the first front on the path, or why there is no front.

    The quads give the depth to a few per cent.  The left-right NCC along the rays of the left quad
    then refines it.

    :param start: what the track starts from.
    :param grid: samples of the front.
    """
    start = replace(start, rig=start.rig.as_taken(start.pair.motion))
    # Distance that the vehicle travels until the right view is exposed.
    speed_mps = start.expected_mps if start.seen_mps is None else start.seen_mps
    later_m = speed_mps * start.pair.right_lag_s
    if later_m:
        start = replace(start, front=_at_one_time(
            start.rig, start.lane.path, start.front, later_m))
    depth = _depth_of_quads(start)
    if isinstance(depth, Refusal):
        return depth
    s_m, cross_ncc = _sharpened(start, grid, depth, later_m)
    if not cross_ncc > start.config.start.least_ncc:
        return _refusal(start, 'left-right correlation', f'{cross_ncc:.2f}',
                        f'above {start.config.start.least_ncc}: quads on the same vehicle front')
    return _placed(start, depth, s_m, cross_ncc)


def first_states(start: TrackStart, placed: Placement, s_std_m: float) -> Array:
    """
    Return the first particles (N, 4) of s, a, b, v on the ray of the front's centre.

    Their speeds scatter about the expected one; a share of them covers all other speeds.

    :param start: what the track starts from.
    :param placed: the placed front.
    :param s_std_m: 1-sigma of their arc lengths, m.
    """
    config, rng, expected = start.config, start.rng, start.expected_mps
    n = config.particles
    ds = s_std_m * rng.standard_normal(n)
    speed = expected * (1 + config.initial_speed_std * rng.standard_normal(n))
    anything = int(n * config.start.any_speed_share)
    speed[:anything] = rng.uniform(0.0, config.start.any_speed_factor * expected, anything)
    return np.column_stack([placed.pose[0] + ds,
                            placed.pose[1:] + ds[:, None] * placed.offset_slope,
                            np.maximum(speed, 0.0)])


# -- the steps of place_front ---------------------------------------------------------------


def _refusal(start: TrackStart, what: str, found: str, wanted: str) -> Refusal:
    return Refusal(f'pair {start.pair.index}: first front', what, found, wanted)


def _at_one_time(rig: StereoRig, path: Path, front: InitialFront, later_m: float) -> InitialFront:
    """Return a front with its right quad moved from its own time to that of the left one."""
    right = front.right_px
    for _ in range(_TIME_STEPS):
        centre = rig.triangulate(front.left_px.mean(axis=0), right.mean(axis=0))
        if not np.isfinite(centre).all():
            break  # the caller refuses it with the reason
        s_m = path.arc_length(centre)
        ahead = centre + path.position(s_m + later_m) - path.position(s_m)
        right = front.right_px - (rig.project(ahead)[1] - rig.project(centre)[1])
    return replace(front, right_px=right)


def _depth_of_quads(start: TrackStart) -> Union[_Depth, Refusal]:
    """Return the depth by triangulation of the centres, or a refusal if they do not match."""
    rig, path, front = start.rig, start.lane.path, start.front
    most_px = start.config.start.most_gap_px
    # At long range, single corners triangulate metres apart; the mean pixel is more precise.
    left_px, right_px = front.left_px.mean(axis=0), front.right_px.mean(axis=0)
    centre = rig.triangulate(left_px, right_px)
    if not np.isfinite(centre).all() or centre[2] <= 0:
        return _refusal(start, 'left and right quads', 'no point in front of the cameras',
                        'quads on the same vehicle front')
    left, right, _, _ = rig.project(centre[None])
    gap_px = float(np.linalg.norm(right[0] - right_px) + np.linalg.norm(left[0] - left_px))
    if not gap_px < most_px:
        return _refusal(start, 'left and right quads', f'lines of sight {gap_px:.1f} px apart',
                        f'quads on the same vehicle front, at most {most_px:g} px')
    s_m = float(path.arc_length(centre))

    def disparity(s_m: float) -> float:
        xy = onto_cross_plane(path, rig.left, s_m, left_px[None])
        point = path.position(np.array(s_m)) + path.frame(np.array(s_m))[:, 1:] @ xy[0]
        left, right, _, _ = rig.project(point[None])
        return float(left[0, 0] - right[0, 0])

    slope = disparity(s_m + _HALF_STEP_M) - disparity(s_m - _HALF_STEP_M)
    s_std_m = front.std_px * np.sqrt(2 / len(front.left_px)) / abs(slope)
    return _Depth(s_m, float(s_std_m), slope)


def _sharpened(start: TrackStart, grid: PartGrid, depth: _Depth, later_m: float
               ) -> tuple[float, float]:
    """Return the arc length of highest posterior by the views' NCC, and the NCC there."""
    reach_m = start.config.start.search_sigmas * depth.s_std_m
    candidates = depth.s_m + np.arange(-reach_m, reach_m, _SEARCH_STEP_PX / abs(depth.slope_px))
    scores = _cross_scores(start, grid, candidates, later_m)
    sigmas = (candidates - depth.s_m) / depth.s_std_m
    samples = start.config.noise.independent_share * grid.unit_xy.shape[0]
    log_posterior = -0.5 * samples * np.log(np.maximum(1 - scores, 1e-3)) - 0.5 * sigmas ** 2
    best = int(np.argmax(log_posterior))
    return float(candidates[best]), float(scores[best])


def _cross_scores(start: TrackStart, grid: PartGrid, candidates: Array, later_m: float) -> Array:
    """Return the left-right NCC with the left quad fixed and the plane at each candidate s."""
    rig, path, left_px = start.rig, start.lane.path, start.front.left_px
    quads = np.stack([
        rig.project(path.position(np.array(s + later_m))
                    + onto_cross_plane(path, rig.left, s, left_px)
                    @ path.frame(np.array(s + later_m))[:, 1:].T)[1]
        for s in candidates])
    left = sample_quads(start.pair.left, left_px[None], grid)
    scores = np.zeros(len(candidates))
    seen = np.isfinite(quads).all(axis=(1, 2))  # the others lie behind the right camera
    if seen.any():
        scores[seen] = ncc(sample_quads(start.pair.right, quads[seen], grid), left[0])
    return scores


def _placed(start: TrackStart, depth: _Depth, s_m: float, cross_ncc: float) -> Placement:
    """Return the front with the left quad's corners on the plane at an arc length."""
    path, camera, left_px = start.lane.path, start.rig.left, start.front.left_px
    quad = onto_cross_plane(path, camera, s_m, left_px)
    offset, centre_px = quad.mean(axis=0), left_px.mean(axis=0, keepdims=True)
    slope = onto_cross_plane(path, camera, s_m + _HALF_STEP_M, centre_px)[0] \
        - onto_cross_plane(path, camera, s_m - _HALF_STEP_M, centre_px)[0]
    return Placement(Front(path, quad - offset), np.array([s_m, *offset]), depth.s_std_m,
                     slope, depth.slope_px, cross_ncc)
