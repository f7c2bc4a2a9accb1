# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Where the vehicle of a track may be, worked by hand."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.pipeline.track import may_be_at


@pytest.mark.parametrize('away_m, near', [
    ((0.0, 0.0, 3.5), True),    # three sigmas of 0.7 m along the view, and 1.4 m
    ((0.0, 0.0, -3.7), False),
    ((1.5, 0.0, 0.0), True),    # three sigmas of 0.02 m across it
    ((-1.6, 0.0, 0.0), False),
    ((0.0, 0.0, 0.0), True),
    ((2.0, 0.0, 2.0), False),   # across the view it is known to 2 cm, however uncertain along it
])
def test_range_of_a_far_front_is_the_uncertain_part_of_its_place(away_m, near):
    place_m = np.array([1.5, -1.0, 73.0])
    update = TrackUpdate(0, 0, 'near', TrackState.TENTATIVE, 20.0, 1.0, 30.0, 0.0, place_m,
                         np.diag(np.square([0.02, 0.02, 0.7])), np.eye(3), np.zeros((4, 2)),
                         np.zeros((4, 2)))
    assert may_be_at(update, place_m + away_m, near_m=1.5) == near
