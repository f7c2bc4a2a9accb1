# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The effect of a turned right camera on the reported uncertainty."""
from __future__ import annotations

from dataclasses import replace
import math
from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.core.passes import PassResult, Reason, SpeedBudget, Verdict
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath
from stereo_speed.steadying.doubt import SpeedDoubt

UPDATE = TrackUpdate(
    stamp_ns=0, track=0, lane='a', state=TrackState.CONFIRMED, speed_mps=20.0, speed_std_mps=0.1,
    s_m=5.0, lateral_m=0.0, position_m=np.zeros(3), position_cov_m2=np.eye(3), axes=np.eye(3),
    quad_left_px=np.zeros((4, 2)), quad_right_px=np.zeros((4, 2)))
RESULT = PassResult(
    track=0, lane='a', first_ns=0, last_ns=9, pairs=9, speed_mps=20.0, speed_std_mps=0.05,
    verdict=Verdict.MEASURED, reason='', smoothed={0: 20.0}, smoothed_std={0: 0.06},
    budget=SpeedBudget(matching_mps=0.04, path_mps=0.0, stamps_mps=0.0, calibration_mps=0.03))


@pytest.fixture(scope='module')
def doubt(rig):
    """Return the doubt of a straight lane 40 m long, 60 m to 20 m ahead."""
    path = StraightPath(np.array([0.0, 2.0, 60.0]), np.array([0.0, 0.0, -1.0]), 40.0,
                        np.array([0.0, -1.0, 0.0]))
    lane = LanePath('a', path, None, np.zeros(2), 0.0)
    return SpeedDoubt(rig, {'a': lane}, TrackerConfig())


@pytest.fixture(scope='module')
def short():
    """Return the doubt of a lane of 1 m, 40 m ahead of parallel cameras and 2 m below them."""
    k = np.array([[1800.0, 0.0, 511.5], [0.0, 1800.0, 383.5], [0.0, 0.0, 1.0]])
    cameras = [Camera(n, 1024, 768, k, np.zeros(0), 'plumb_bob') for n in ('left', 'right')]
    rig = StereoRig(*cameras, np.eye(3), np.array([-0.5, 0.0, 0.0]))
    path = StraightPath(np.array([0.25, 2.0, 40.5]), np.array([0.0, 0.0, -1.0]), 1.0,
                        np.array([0.0, -1.0, 0.0]))
    return SpeedDoubt(rig, {'a': LanePath('a', path, None, np.zeros(2), 0.0)}, TrackerConfig())


TURN_RAD = np.radians([0.02, 0.0, 0.0])


def steadier(*, turned=False, too_far=False, lost=False, std_deg=0.0005):
    """Stand in for the object that has watched the rig."""
    drift = SimpleNamespace(turned=turned, too_far=too_far,
                            corrected_rad=TURN_RAD if turned else np.zeros(3),
                            covariance_rad2=np.radians(std_deg) ** 2 * np.eye(3))
    return SimpleNamespace(drift=drift, lost=lost)


def test_fixed_rig_changes_nothing(doubt):
    assert doubt.update(UPDATE, steadier()) is UPDATE
    assert doubt.result(RESULT, doubt.share('a', steadier())) is RESULT


def test_uncertain_angle_of_a_rotated_camera_is_in_every_sigma(doubt):
    watch = steadier(turned=True)
    share = doubt.share('a', watch)
    # A pan of one rad changes lengths at range Z by 2 Z / b; near observations weigh most.
    pan = np.radians(0.0005)
    assert 2 * 20 / 0.5 * pan < share < 2 * 60 / 0.5 * pan
    update, result = doubt.update(UPDATE, watch), doubt.result(RESULT, share)
    assert doubt.shares(watch) == {'a': share}
    assert update.speed_std_mps == pytest.approx(math.hypot(0.1, 20 * share))
    assert update.state is TrackState.CONFIRMED and result.verdict is Verdict.MEASURED
    assert result.speed_std_mps == pytest.approx(math.hypot(0.05, 20 * share))
    assert result.budget.total_mps == pytest.approx(result.speed_std_mps)
    assert result.smoothed_std[0] == pytest.approx(math.hypot(0.06, 20 * share))


@pytest.mark.parametrize(('correlation', 'wanted'), [
    (0.0, math.sqrt(2) * 1.6e-3), (-1.0, 3.2e-3), (0.75, math.sqrt(0.5) * 1.6e-3)])
def test_correlated_angles_add_or_cancel(correlation, wanted, short):
    """
    Work out the share of a pan that changes speeds by +160 and a roll that does by -4 per rad.

    1e-5 rad of pan and 4e-4 rad of roll each change speeds by 1.6e-3, with opposite signs.
    """
    pan, roll = 1e-5, 4e-4
    watch = steadier(turned=True)
    watch.drift.covariance_rad2 = np.array([
        [pan**2, 0.0, correlation * pan * roll], [0.0, 0.0, 0.0],
        [correlation * pan * roll, 0.0, roll**2]])
    assert short.share('a', watch) == pytest.approx(wanted, rel=0.03)


def test_changes_of_several_angles_do_not_cancel(short):
    """The largest changes of two angles may be of different pairs and of either sign."""
    changed = np.array([1e-5, 0.0, 4e-4])
    assert short.share('a', steadier(), changed) == pytest.approx(3.2e-3, rel=0.03)


def test_a_lane_that_no_camera_sees_is_uncertain_without_limit(rig):
    behind = StraightPath(np.array([0.0, 2.0, -60.0]), np.array([0.0, 0.0, -1.0]), 40.0)
    doubt = SpeedDoubt(rig, {'a': LanePath('a', behind, None, np.zeros(2), 0.0)}, TrackerConfig())
    assert doubt.share('a', steadier()) == 0.0
    assert math.isinf(doubt.share('a', steadier(turned=True)))
    assert math.isinf(doubt.share('a', steadier(), TURN_RAD))


@pytest.mark.parametrize('watch', [steadier(turned=True, too_far=True),
                                   steadier(turned=True, std_deg=0.005)],
                         ids=['too far', 'too uncertain'])
def test_uncorrectable_rotation_withholds_readings(watch, doubt):
    assert doubt.update(UPDATE, watch).state is TrackState.TENTATIVE
    result = doubt.result(RESULT, doubt.share('a', watch))
    assert result.verdict is Verdict.REJECTED and result.reason == Reason.RIG_UNCERTAIN
    assert result.speed_mps is None


@pytest.mark.parametrize('watch', [steadier(turned=True), steadier()],
                         ids=['found', 'taken back'])
def test_vehicle_seen_before_and_after_a_rotation_was_found_is_withheld(watch, doubt):
    """Its pairs may be on either side of the turn, whatever correction they got."""
    assert doubt.update(UPDATE, watch, TURN_RAD).state is TrackState.TENTATIVE
    assert doubt.share('a', watch, TURN_RAD) > 2 * 20 / 0.5 * TURN_RAD[0]
    result = doubt.result(RESULT, doubt.share('a', watch, TURN_RAD))
    assert result.reason == Reason.RIG_UNCERTAIN


@pytest.mark.parametrize('reason, share, wanted', [
    ('views_disagree', 1e-4, 'views_disagree'), ('views_disagree', math.inf, 'rig_uncertain'),
    ('too_far', math.inf, 'too_far')])
def test_views_that_disagree_after_a_turn_are_blamed_on_it(doubt, reason, share, wanted):
    assert doubt.result(RESULT.rejected(Reason(reason)), share).reason == wanted


def test_readings_wait_while_the_state_of_a_swaying_rig_is_unknown(doubt):
    assert doubt.update(UPDATE, steadier(lost=True)).state is TrackState.TENTATIVE
    coasting = replace(UPDATE, state=TrackState.COASTING)
    assert doubt.update(coasting, steadier(lost=True)) is coasting
