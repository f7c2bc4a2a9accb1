# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Upright and lying patches are told apart, in images drawn by their closed forms."""
from __future__ import annotations

import math

import numpy as np
import pytest
from stereo_speed.core.records import StereoPair, TrackState, TrackUpdate
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath
from stereo_speed.tracking.upright import Upright

FOCAL_PX, BASELINE_M, HIGH_M, FAR_M, LONG_M = 1000.0, 0.5, 4.0, 30.0, 80.0
CAMERAS = [Camera(name=name, width_px=320, height_px=240, D=(), model='plumb_bob',
                  K=np.array([[FOCAL_PX, 0, 160.0], [0, FOCAL_PX, 40.0], [0, 0, 1]]))
           for name in ('left', 'right')]
RIG = StereoRig(*CAMERAS, np.eye(3), np.array([-BASELINE_M, 0, 0]))
LANE = LanePath('lane', StraightPath([0, HIGH_M, LONG_M], [0, 0, -1.0], 60.0), None,
                np.zeros(2), 0.0)
AXES = np.array([[0, 1.0, 0], [0, 0, -1.0], [-1.0, 0, 0]])  # towards the cameras, left, up
SIDES_M = np.array([[-0.8, -0.3], [0.8, -0.3], [0.8, 0.3], [-0.8, 0.3]])  # to the right, down
MIDDLE_M = np.array([0.0, HIGH_M - 0.6, FAR_M])
LAG_NS = 20_000_000


def waves(x_m, y_m):
    """Return a texture: grey values at places of a plane."""
    return 120 + 30 * np.sin(9 * x_m + 1) * np.cos(7 * y_m) + 20 * np.sin(15 * x_m + 4 * y_m)


def view(x_m, stands, ahead_m=0.0):
    """Draw a camera's view some way to the right: a wall at the front's depth, or the road."""
    v, u = np.mgrid[:240, :320].astype(float)
    across, down = (u - 160) / FOCAL_PX, np.maximum(v - 40, 0.5) / FOCAL_PX
    if stands:
        far_m = FAR_M - ahead_m
        grey = waves(x_m + across * far_m, down * far_m)
    else:  # waves on the road look as long as at the front's depth
        far_m = HIGH_M / down
        grey = waves(x_m + across * far_m, (far_m + ahead_m) / 6)
    noise = np.random.default_rng(round(10 * x_m)).normal(0, 1, grey.shape)
    return np.clip(np.round(grey + noise), 0, 255).astype(np.uint8)


def seen(stands, lag_ns=0, speed_mps=0.0, lane=LANE, **changes):
    """Return the evidence of one pair, whose right view may be later."""
    images = {'left': view(0.0, stands),
              'right': view(BASELINE_M, stands, speed_mps * lag_ns * 1e-9), **changes}
    corners_m = MIDDLE_M + np.column_stack([SIDES_M, np.zeros(4)])
    upright = Upright(RIG, lane)
    upright.take(StereoPair(0, 0, lag_ns, images['left'], images['right']), TrackUpdate(
        0, 0, 'lane', TrackState.CONFIRMED, speed_mps, 0.1, LONG_M - FAR_M, 0.0, MIDDLE_M,
        np.eye(3), AXES, *RIG.project(corners_m)[:2]))
    return upright


@pytest.mark.parametrize('lag_ns', [0, LAG_NS])
@pytest.mark.parametrize('stands', [False, True])
def test_upright_fronts_are_separated_from_flat_markings(stands, lag_ns):
    found = seen(stands, lag_ns, 30.0)
    assert found.lies is not stands and abs(found.evidence) > 1.0


def test_small_error_of_the_road_height_is_tolerated():
    """An unknown 3 cm do not make a shadow upright."""
    raised = LanePath('lane', StraightPath([0, HIGH_M + 0.03, LONG_M], [0, 0, -1.0], 60.0), None,
                      np.zeros(2), 0.0)
    assert seen(False, lane=raised).lies and not seen(True, lane=raised).lies


@pytest.mark.parametrize('changes', [
    {'left': np.full((240, 320), 90, np.uint8)}, {'right': np.full((240, 320), 90, np.uint8)}])
def test_texture_free_pair_has_no_evidence(changes):
    found = seen(True, **changes)
    assert found.evidence == pytest.approx(0.0, abs=1e-12) and not found.lies


def test_evidence_by_hand():
    """Equal agreement in both places is no evidence; in one place only, the floor's share."""
    everywhere = np.tile(waves(np.arange(320) / 50.0, 0.0), (240, 1)).astype(np.uint8)
    assert abs(seen(True, left=everywhere, right=everywhere).evidence) < math.log(2.005 / 0.005)
    assert 1.0 < seen(True).evidence < math.log(2.005 / 0.005)


def test_evidence_of_pairs_adds_up():
    one = seen(True)
    twice = one.evidence
    pair = StereoPair(0, 0, 0, view(0.0, False), view(BASELINE_M, False))
    corners_m = MIDDLE_M + np.column_stack([SIDES_M, np.zeros(4)])
    update = TrackUpdate(0, 0, 'lane', TrackState.CONFIRMED, 0.0, 0.1, LONG_M - FAR_M, 0.0,
                         MIDDLE_M, np.eye(3), AXES, *RIG.project(corners_m)[:2])
    one.take(pair, update)
    assert one.evidence == pytest.approx(twice + seen(False).evidence)


def test_front_out_of_view_has_no_evidence():
    upright = seen(True)
    before = upright.evidence
    corners_m = MIDDLE_M + [6.0, 0.0, 0.0] + np.column_stack([SIDES_M, np.zeros(4)])
    upright.take(StereoPair(0, 0, 0, view(0.0, True), view(BASELINE_M, True)), TrackUpdate(
        0, 0, 'lane', TrackState.CONFIRMED, 0.0, 0.1, LONG_M - FAR_M, 0.0,
        MIDDLE_M + [6.0, 0, 0], np.eye(3), AXES, *RIG.project(corners_m)[:2]))
    assert upright.evidence == before


def test_weak_evidence_is_not_taken_for_a_flat_marking():
    """With noise in both views the road may agree slightly better, but not by odds of 20 to 1."""
    rng = np.random.default_rng(4)
    found = [seen(True, left=rng.integers(0, 256, (240, 320), np.uint8),
                  right=rng.integers(0, 256, (240, 320), np.uint8)) for _ in range(20)]
    assert any(one.evidence < 0 for one in found)
    assert not any(one.lies for one in found)
