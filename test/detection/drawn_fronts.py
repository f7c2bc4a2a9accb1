# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A small scene for tests of the detectors: a flat textured front on a flat textured road."""
from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import ndimage
from stereo_speed.core.records import StereoPair
from stereo_speed.detection.pyramid import PairPyramids, PairRegions, Region
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath

HEIGHT_M = 6.0  # of the cameras above the road
LANE_M = 6.0  # of the middle of the lane, to the right of the left camera
START_M = 70.0  # from the cameras to the beginning of the lane
SPEED_MPS = 22.0
STEP_NS = 200_000_000
CELL_M = 0.12  # of the front's texture
HALF_M = 0.9
LOW_M, HIGH_M = 0.15, 1.4
NOISE = 1.0

CAMERAS = [Camera(name=name, width_px=640, height_px=420, D=(), model='plumb_bob',
                  K=np.array([[1200.0, 0, 100], [0, 1200.0, 20], [0, 0, 1]]))
           for name in ('left', 'right')]
RIG = StereoRig(*CAMERAS, np.eye(3), np.array([-0.5, 0, 0]))
LANE = LanePath('lane', StraightPath([LANE_M, HEIGHT_M, START_M], [0, 0, -1.0], 50.0), None,
                np.zeros(2), 0.0)
LANES = {'lane': LANE}
_ROAD = np.random.default_rng(0).uniform(92, 108, (80, 80))
_FRONT = np.random.default_rng(1).uniform(20, 230, (12, 12))


@dataclass(frozen=True)
class Front:
    """
    A flat object that stands on the road, or lies on it.

    :param s_m: arc length.
    :param x_m: offset of its middle to the left of travel.
    :param symmetric: whether it is its own mirror image.
    :param lying: it is painted on the road.
    :param pole_m: half the width of a pole in front of its middle.
    :param half_m: half of its width.
    :param low_m: height of its lower edge above the road.
    :param high_m: height of its upper edge.
    :param light: factor of its grey values.
    :param shadow_m: how far its shadow, black and 8 m long, reaches to its right.
    :param lamps_m: heights of the lower and the upper edge of two lamps that clip, 0.25 m wide.
    """

    s_m: float
    x_m: float = 0.0
    symmetric: bool = True
    lying: bool = False
    pole_m: float = 0.0
    half_m: float = HALF_M
    low_m: float = LOW_M
    high_m: float = HIGH_M
    light: float = 1.0
    shadow_m: float = 0.0
    lamps_m: tuple[float, float] = (0.0, 0.0)


@lru_cache(maxsize=8)
def _rays(camera):
    v, u = np.mgrid[:camera.height_px, :camera.width_px]
    return camera.rays(np.stack([u, v], -1).astype(float))


@lru_cache(maxsize=8)
def _road(camera, centre_m):
    """Return where the rays of pixels meet the road, and its grey values there."""
    rays, centre_m = _rays(camera), np.array(centre_m)
    ground = centre_m + rays * ((HEIGHT_M - centre_m[1]) / np.maximum(rays[..., 1:2], 1e-3))
    at = np.stack([ground[..., 0] / 0.7 + 40, ground[..., 2] / 2.0])
    return ground, ndimage.map_coordinates(_ROAD, at, order=1, mode='reflect')


def drawn(camera, centre_m, fronts, rng):
    """Draw the view of a camera at a position, parallel to the left one."""
    ground, road = _road(camera, tuple(float(c) for c in centre_m))
    image = road.copy()
    for front in fronts:
        far = START_M - front.s_m
        beside, behind = ground[..., 0] - LANE_M - front.x_m, ground[..., 2] - far
        if front.shadow_m > 0:
            image[(behind > -1) & (behind < 7) & (beside > 0)
                  & (beside < front.half_m + front.shadow_m)] = 5.0
        on = ground if front.lying else centre_m + _rays(camera) * (far - centre_m[2])
        x = on[..., 0] - LANE_M - front.x_m
        h = far - on[..., 2] if front.lying else HEIGHT_M - on[..., 1]
        here = (np.abs(x) <= front.half_m) & (h >= front.low_m) & (h <= front.high_m)
        column = (np.abs(x[here]) if front.symmetric else 0.7 * x[here]) / CELL_M
        values = ndimage.map_coordinates(_FRONT, np.stack([h[here] / CELL_M, column + 2]),
                                         order=1, mode='reflect')
        image[here] = np.where(np.abs(x[here]) < front.pole_m, 128.0, front.light * values)
        low_m, high_m = front.lamps_m
        image[(np.abs(np.abs(x) - 0.65) < 0.125) & (h > low_m) & (h < high_m)] = 400.0
    noisy = image + rng.normal(0, NOISE, image.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def pair_of(fronts, index=0, late=None, lag_ns=0):
    """
    Draw a pair.

    :param late: the fronts when the right view is exposed, where that is later.
    """
    rng = np.random.default_rng(100 + index)
    stamp_ns = 1_700_000_000_000_000_000 + index * STEP_NS
    left = drawn(CAMERAS[0], np.zeros(3), fronts, rng)
    right = drawn(CAMERAS[1], np.array([0.5, 0, 0]), fronts if late is None else late, rng)
    return StereoPair(index, stamp_ns, stamp_ns + lag_ns, left, right)


def pyramids_of(pair):
    """Return the pyramids of whole images."""
    return PairPyramids.of(pair, PairRegions(*(Region(0, 0, c.width_px, c.height_px)
                                               for c in CAMERAS)), RIG)


def depth_bound_m(geometry, s_m, disparity_px=0.1):
    """
    Return the bound on the error of a front along the lane.

    From the error of its disparity, and the 6 mm in the right view at which its refinement stops.
    """
    rates = geometry.exact_rates(np.array([s_m]))
    shift_m = max(disparity_px / float(rates.px_per_m[0]), 0.006)
    return shift_m / abs(float(rates.shift[0]))
