# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Which of two tracks on one vehicle ends, and where a track's vehicle is expected."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.core.tracker_config import AssociationConfig
from stereo_speed.pipeline.roster import Roster
from stereo_speed.pipeline.search import VehicleSearch
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath

UP = np.array([0.0, -1.0, 0.0])
SECOND = 10 ** 9


def track_of(number, z_m, *, receding, lane='lane', s_m=0.0, speed_mps=0.0, x_m=0.0, half_m=1.0):
    """Return a confirmed track 2 m below the cameras, which sees its vehicle at 1000 px."""
    ahead = np.array([0.0, 0.0, 1.0 if receding else -1.0])
    axes = np.stack([ahead, np.cross(UP, ahead), UP], axis=-1)
    left, right = (500 + 1000 / z_m * (x_m + side * half_m) for side in (-1, 1))
    quad = np.array([[left, 80.0], [right, 80.0], [right, 120.0], [left, 120.0]])
    update = TrackUpdate(SECOND, number, lane, TrackState.CONFIRMED, speed_mps, 0.1, s_m, 0.0,
                         np.array([x_m, 2.0, z_m]), np.eye(3), axes, quad, quad)
    return SimpleNamespace(last=update, confirmed=True, ended=False, detection=None,
                           doubted=False, tracker=SimpleNamespace(track=number))


@pytest.mark.parametrize('receding', [False, True])
@pytest.mark.parametrize('order', [(0, 1), (1, 0)])
def test_front_within_the_vehicle_of_another_one_ends(receding, order):
    """That is the farther one, as the end that faces the cameras is tracked."""
    both = track_of(0, 30.0, receding=receding), track_of(1, 31.8, receding=receding)
    roster = Roster(1.5)
    roster.tracks = [both[k] for k in order]
    assert [t.tracker.track for t in roster.drop_doubles(SECOND)] == [1]
    assert [t.tracker.track for t in roster.tracks] == [0]


@pytest.mark.parametrize(('x_m', 'half_m', 'z_m', 'held'), [
    (1.05, 0.4, 60.3, [0]),  # the mirror of a lorry
    (-1.05, 0.4, 60.3, [0]),
    (1.05, 0.4, 62.5, [0, 1]),  # as far behind its front as two vehicles may be
    (1.05, 0.4, 59.8, [0, 1]),  # before it
    (1.7, 0.4, 60.3, [0, 1])], ids=['left', 'right', 'behind', 'before', 'beside'])
@pytest.mark.parametrize('receding', [False, True])
def test_narrow_front_within_a_wide_one_ends(x_m, half_m, z_m, held, receding):
    """A two-wheeler that is marked where a lorry hides it would be the lorry's second track."""
    roster = Roster(0.5)
    roster.tracks = [track_of(0, 60.0, receding=receding, half_m=1.25),
                     track_of(1, z_m, receding=receding, x_m=x_m, half_m=half_m)]
    roster.drop_doubles(SECOND)
    assert [t.tracker.track for t in roster.tracks] == held


@pytest.mark.parametrize(('lane', 's_m'), [('own', 59.0), ('other', 50.0)])
def test_overtaker_is_expected_ahead_of_it_in_either_lane(lane, s_m):
    """It approaches at 18 m/s, in the lane of those who recede too."""
    lanes = {name: LanePath(name, StraightPath(np.array([x, 2.0, z]), np.array([0.0, 0.0, ahead]),
                                               100.0, UP), None, np.zeros(2), 0.0)
             for name, x, z, ahead in (('own', 0.0, 110.0, -1.0), ('other', 1.0, 1.0, 1.0))}
    rig = SimpleNamespace(left=SimpleNamespace(metres_per_px=lambda z_m: z_m / 1000.0))
    search = VehicleSearch(rig, None, AssociationConfig(), lanes)
    track = track_of(0, 51.0, receding=False, lane=lane, s_m=s_m, speed_mps=18.0)
    pair = SimpleNamespace(stamp_ns=SECOND + SECOND // 2)
    region, = search.of(pair, [track]).tracked
    assert lanes[lane].path.position(np.array(region.s_m))[2] == pytest.approx(42.0)
    assert region.oncoming is (lane == 'other')
