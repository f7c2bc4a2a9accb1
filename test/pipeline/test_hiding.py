# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Which fronts other vehicles hide, worked by hand with a focal length of 1000 px."""
from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.pipeline.hiding import is_hidden
from stereo_speed.pipeline.track import Track

K = np.array([[1000.0, 0, 512], [0, 1000, 384], [0, 0, 1]])
CAMERAS = [Camera(name=side, width_px=1024, height_px=768, K=K, D=(), model='plumb_bob')
           for side in ('left', 'right')]
RIG = StereoRig(*CAMERAS, np.eye(3), np.array([-0.5, 0, 0]))
# Vehicles come towards the camera: heading, left and up, left optical frame.
AXES = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]]).T
APART_M = 1.5


def front(track, centre_m, size_m, stamp_ns=0, speed_mps=20.0):
    """Return the update of a front of a width and height at a place, m."""
    half_x, half_y = np.array(size_m) / 2
    corners = np.array(centre_m) + np.array(
        [[-half_x, -half_y, 0], [half_x, -half_y, 0], [half_x, half_y, 0], [-half_x, half_y, 0]])
    left, right, *_ = RIG.project(corners)
    return TrackUpdate(stamp_ns, track, 'near', TrackState.CONFIRMED, speed_mps, 0.2, 10.0, 0.0,
                       np.array(centre_m), np.eye(3), AXES, left, right)


def hides(centre_m, size_m=(1.8, 0.8), *, confirmed=True, doubted=False, stamp_ns=0, rig=RIG,
          **changes):
    """Return whether a front at a place hides one at 80 m, 20 px wide and 6 px high."""
    last = replace(front(1, centre_m, size_m, stamp_ns), **changes)
    far = front(0, (0.0, 1.0, 80.0), (1.6, 0.5))
    tracks = [Track(None, None, None, 0, None, None, None, last=update, confirmed=sure,
                    doubted=doubted)
              for update, sure in ((far, True), (last, confirmed), (None, False))]
    return is_hidden(far, tracks, rig, APART_M)


@pytest.mark.parametrize('centre_m, hidden', [
    ((0.6, 1.0, 60.0), True),    # from -5 to 25 px, and the far front from -10 to 10
    # In the right view it is 2.1 px further to the left, relative to the far front.
    ((1.45, 1.0, 60.0), True),   # from 9.2 and 7.1 px on, which is more than a tenth
    ((1.56, 1.0, 60.0), False),  # from 11 and 8.9 px on
    ((-1.1, 1.0, 60.0), True),   # up to -3.3 and -5.4 px
    ((-1.75, 1.0, 60.0), False),
])
def test_nearer_vehicle_hides_what_is_behind_it(centre_m, hidden):
    assert hides(centre_m) == hidden


@pytest.mark.parametrize('beside_m, hidden', [(1.3, True), (1.7, False)])
def test_one_view_suffices(beside_m, hidden):
    """
    In the right view a vehicle at 20 m is 18.8 px further to the left, relative to the far front.

    Its left edge is 20 or 40 px in the left view, so 1 or 21 px in the right one.
    """
    assert hides((beside_m, 0.4, 20.0)) == hidden


@pytest.mark.parametrize('drop_m, hidden', [(0.3, True), (0.6, False)])
def test_vehicle_is_higher_than_its_front(drop_m, hidden):
    """
    The far front ends 15.6 px down; a bumper of 0.3 m begins 19 or 24 px down.

    The vehicle of the bumper begins 0.6 m above its lower edge, 14 or 19 px down.
    """
    assert hides((0.0, 1.0 + drop_m, 60.0), (1.8, 0.3)) == hidden


@pytest.mark.parametrize('changes', [
    {'confirmed': False}, {'doubted': True}, {'state': TrackState.COASTING}, {'track': 0}])
def test_only_other_vehicles_that_are_surely_there_hide(changes):
    assert not hides((0.6, 1.0, 60.0), **changes)


@pytest.mark.parametrize('at_m', [79.0, 100.0])
def test_same_vehicle_and_those_behind_it_do_not_hide(at_m):
    assert not hides((0.6, 1.0, at_m))


@pytest.mark.parametrize('before_s, hidden', [(0.0, False), (1.0, True), (5.0, False)])
def test_place_is_predicted_from_the_last_update(before_s, hidden):
    """After 1 s at 20 m/s it is at 65 m, nearer than the front; after 5 s behind the camera."""
    assert hides((0.6, 1.0, 85.0), stamp_ns=-round(before_s * 1e9)) == hidden


def test_rig_as_it_stood_decides():
    """A pan of 0.5 degrees moves the silhouette by 8.7 px, away from pixels already measured."""
    assert hides((1.45, 1.0, 60.0))
    assert not hides((1.45, 1.0, 60.0), rig=RIG.swayed((math.radians(-0.5), 0.0, 0.0)))


def test_vehicle_beside_the_view_hides_nothing():
    """At 1 m, 1.6 m aside, its front is out of both images, however wide."""
    assert not hides((1.6, 0.2, 1.0), (3.4, 0.8))
    assert hides((0.3, 0.2, 1.0), (3.0, 0.8))
