# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reflections of lamps on a wet road: streaks around their mirror images."""
from __future__ import annotations

import numpy as np

from .planes import Eye
from .texture import Image
from ...core.records import Array

TILT_RAD = 0.03  # 1-sigma of the slopes of wet asphalt
WATER = 0.02  # share of the light that water reflects at normal incidence
REACH = 3.0  # sigmas up to which a streak is drawn
NEAREST_M = 2.0  # lamps nearer to a camera are not reflected


def streak(image: Image, eye: Eye, lamp_m: Array, mirrored_m: Array, grey: float,
           radius_m: float, wet: float) -> None:
    """
    Add the reflection of a lamp on a wet road, in place.

    The facets that reflect it towards the camera lie along the line to it: the streak is
    vertically long and narrow, centred at the lamp's mirror image.

    :param lamp_m: (3,), the lamp, left optical frame.
    :param mirrored_m: (3,), its mirror image below the road.
    :param grey: grey level of the lamp in the direction of the road.
    :param radius_m: radius of the lamp.
    :param wet: wetness, 0 to 1.
    """
    view = eye.view
    z = float((view.R @ mirrored_m + view.t)[2])
    uv = eye.project(mirrored_m[None])
    if z < NEAREST_M or not len(uv):
        return
    ray = mirrored_m - eye.centre_m
    up = lamp_m - mirrored_m
    grazing = abs(float(ray @ up)) / float(np.linalg.norm(ray) * np.linalg.norm(up))
    f_px = float(view.camera.K[0, 0])
    size = max(radius_m * f_px / z, 0.3)
    tall = float(np.hypot(2 * TILT_RAD * f_px, size))
    wide = float(np.hypot(2 * TILT_RAD * grazing * f_px, size))
    box = eye.box(uv + np.outer((-REACH, 0.0, REACH), (wide, tall)), 0)
    if box is None:
        return
    share = wet * (WATER + (1 - WATER) * (1 - grazing) ** 5)
    # All light of the lamp's disc is spread over the streak.
    peak = grey * share * size * size / (2 * wide * tall)
    u0, u1, v0, v1 = box
    row, column = (np.exp(-np.square((np.arange(*ends) - middle) / sigma) / 2)
                   for ends, middle, sigma in (((u0, u1), uv[0, 0], wide),
                                               ((v0, v1), uv[0, 1], tall)))
    image[v0:v1, u0:u1] += (peak * np.outer(column, row)).astype(np.float32)
