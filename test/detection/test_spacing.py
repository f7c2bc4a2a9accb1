# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Distances below which two fronts are no two vehicles, by hand."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.detection.config import SpacingConfig
from stereo_speed.detection.spacing import Place, Spacing
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import SplinePath, StraightPath

PATH = StraightPath(np.array([0.0, 2.0, 90.0]), np.array([0.0, 0.0, -1.0]), 80.0,
                    np.array([0.0, -1.0, 0.0]))
LANES = {'lane': LanePath('lane', PATH, None, np.zeros(2), 0.0)}
VAN = Place(np.array([0.0, 2.0, 40.0]), 0.96, 'lane')


@pytest.mark.parametrize(('apart_m', 'behind_m', 'limits', 'too_near'), [
    (0.05, 5.0, {}, True),  # what the shadow of the van's side looks like
    (0.3, 5.0, {}, False),  # a vehicle beside it
    (0.05, 5.0, {'beside_m': 0.0}, False),
    (0.05, 8.0, {}, False),  # 4.5 m and 0.3 s at 8 m/s are 6.9 m
    (0.05, 8.0, {'headway_s': 0.5}, True)])
def test_vehicles_beside_each_other_keep_a_distance(apart_m, behind_m, limits, too_near):
    one = Place(np.array([0.96 + apart_m + 0.6, 2.0, 40.0 + behind_m]), 0.6, 'lane')
    spacing = Spacing(LANES, SpacingConfig(**limits))
    assert spacing.meet('lane', one, [VAN], 8.0) == too_near


@pytest.mark.parametrize('goes_away', [False, True])
def test_side_of_a_vehicle_follows_the_bend(goes_away):
    """Along 14 m of a bend of 60 m radius, its tangent is 1.6 m off."""
    angle = np.linspace(0.0, 1.0, 61)
    points = np.stack([60 * np.cos(angle) - 60, np.full(61, 2.0), 10 + 60 * np.sin(angle)], -1)
    path = SplinePath(points if goes_away else points[::-1], np.array([0.0, -1.0, 0.0]))
    spacing = Spacing({'lane': LanePath('lane', path, None, np.zeros(2), 0.0)}, SpacingConfig())
    front_m = 20.0 if goes_away else 40.0

    def place(farther_m, left_m, half_m):
        s = np.array(front_m + farther_m if goes_away else front_m - farther_m)
        return Place(path.position(s) + left_m * path.frame(s)[:, 1], half_m)
    found = [spacing.is_at_side('lane', place(14.0, left_m, 0.35), [place(0.0, 0.0, 1.25)],
                                18.0, 0.5) for left_m in (-2.5, -1.3, 0.0, 1.3, 2.5)]
    assert found == [False, True, False, True, False]
