# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Occlusion of a road by itself: lines behind a crest are not visible, even if clicked."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .fitted import RoadFit
from ..core.records import Array

_ALONG, _ACROSS = 161, 9  # samples of the surface along and across the road
_BESIDE_M = 1.0  # width of the road beyond the outer lines
_SPARE_M = 0.05  # least height by which the surface must rise above a line of sight
_NEARER_M = 1.0  # least distance of an occluding sample in front of the occluded one


def hidden(fit: RoadFit, line: int, right: bool, s_m: Array) -> NDArray[np.bool_]:
    """
    Return which places (n,) of a line are occluded by the surface of its road.

    :param line: number of the line.
    :param right: whether it is seen from the right camera.
    :param s_m: (n,) reference arc lengths, m.
    """
    model = fit.problem.model
    if model.shape.flat:
        return np.zeros(len(s_m), dtype=bool)
    rig, nodes = fit.problem.rig, model.s_m
    eye = -rig.R.T @ rig.t if right else np.zeros(3)
    offsets = model.offsets(fit.x) - model.offsets(fit.x)[line]
    across = np.linspace(offsets.min() - _BESIDE_M, offsets.max() + _BESIDE_M, _ACROSS)
    along = np.linspace(nodes[0], nodes[-1], _ALONG)
    surface = fit.points(line, along, np.tile(across, (_ALONG, 1))) - eye
    axes = model.reference(fit.x)[1][len(nodes) // 2]
    here = (fit.points(line, np.asarray(s_m), np.zeros(len(s_m))) - eye) @ axes
    there = surface.reshape(-1, 3) @ axes
    way, ways = (np.hypot(p[:, 0], p[:, 1]) for p in (here, there))
    side, sides = (np.arctan2(p[:, 1], p[:, 0]) for p in (here, there))
    turned = np.abs(np.mod(side[:, None] - sides + np.pi, 2 * np.pi) - np.pi)
    before = (ways < way[:, None] - _NEARER_M) & (
        turned < 0.75 * (across[1] - across[0]) / np.maximum(ways, 1.0))
    above = there[:, 2] / ways - (here[:, 2] / way)[:, None] > _SPARE_M / way[:, None]
    return np.asarray((before & above).any(axis=1))
