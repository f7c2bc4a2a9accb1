# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Verdicts and budgets of passes: each reason once, and figures by hand."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.passes import Verdict
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath
from stereo_speed.tracking.pass_result import conclude, Pass
from stereo_speed.tracking.posterior import Posterior, SolvedPass

SECOND = 1_000_000_000
EXACT = TrackerConfig(focal_std=0.0, baseline_std_m=0.0)


def rig():
    K = np.array([[1000.0, 0, 512], [0, 1000.0, 384], [0, 0, 1]])
    left, right = (Camera(name=side, width_px=1024, height_px=768, K=K, D=np.zeros(5),
                          model='plumb_bob') for side in ('left', 'right'))
    return StereoRig(left=left, right=right, R=np.eye(3), t=np.array([-0.5, 0, 0]))


def found(speeds=(20.0, 20.0, 20.0, 20.0, 20.0), std=0.1, **changes):
    """Return a pass of one pair a second, its speeds independent and equally uncertain."""
    n = len(speeds)
    mean = np.zeros((n, 4))
    mean[:, 3] = speeds
    covariance = np.zeros((4 * n, 4 * n))
    covariance[3::4, 3::4] = std ** 2 * np.eye(n)
    posterior = Posterior(0, np.arange(float(n)), mean, covariance, np.zeros(n), np.zeros(n),
                          np.ones(n), np.full(n, 0.9), *np.ones((2, n), bool), 0.3)
    lane = LanePath('right', StraightPath(np.array([0.0, 2, 60]), np.array([0.0, 0, -1]), 50.0),
                    None, np.full(2, 1e-3), 0.1)
    parts = std ** 2 * np.eye(n)
    base = Pass(track=3, lane=lane, stamps_ns=[k * SECOND for k in range(n)],
                solved=SolvedPass(posterior, frozenset(), 0.8 * parts, 0.5 * parts),
                extent_px=100.0, end='left_view')
    return replace(base, **changes)


def changed(solved, **changes):
    """Return a solved pass with another posterior."""
    return replace(solved, posterior=replace(solved.posterior, **changes))


def test_speeds_keep_their_times_when_the_first_observation_is_left_out():
    late = found((20.0, 21.0, 22.0, 23.0, 24.0), stamps_ns=[k * SECOND for k in (1, 2, 3, 4)])
    result = conclude(late, rig(), TrackerConfig())
    assert result.smoothed == pytest.approx(
        {SECOND: 21.0, 2 * SECOND: 22.0, 3 * SECOND: 23.0, 4 * SECOND: 24.0})
    assert (result.pairs, result.speed_mps) == (4, pytest.approx(22.5))


def test_budget_adds_up():
    config = TrackerConfig(focal_std=0.001, baseline_std_m=0.0)
    result = conclude(found(std=0.05), rig(), config)
    whole = 0.05 / np.sqrt(5)  # of the mean of five independent speeds
    budget = result.budget
    assert budget.matching_mps == pytest.approx(whole * np.sqrt(0.5))
    assert budget.path_mps == pytest.approx(whole * np.sqrt(0.3))
    assert budget.stamps_mps == pytest.approx(whole * np.sqrt(0.2))
    assert budget.calibration_mps == pytest.approx(0.02)
    assert result.speed_std_mps == pytest.approx(np.hypot(whole, 0.02))
    assert (result.verdict, result.speed_mps, result.end) == (
        Verdict.MEASURED, pytest.approx(20.0), 'left_view')
    assert result.smoothed_std[0] == pytest.approx(np.hypot(0.05, 0.02))


def test_speed_is_the_time_mean_despite_left_out_observations():
    # Observations at 0 and 4 s, pairs at 0, 1, 2 and 4 s; between them the profile is a line, and
    # the pair at 3 s, in which it was hidden, would have shown 17 m/s.
    braking = found(speeds=(20.0, 16.0))
    solved = changed(braking.solved, stamps_s=np.array([0.0, 4.0]))
    result = conclude(replace(braking, solved=solved,
                              stamps_ns=[0, SECOND, 2 * SECOND, 4 * SECOND]), rig(), EXACT)
    assert result.speed_mps == pytest.approx((20 + 19 + 18 + 17 + 16) / 5)
    assert result.profile_mps == (20.0, 16.0, 20.0)


@pytest.mark.parametrize('reason, changes', [
    ('never_seen', {'solved': None}),
    ('too_few_pairs', {'stamps_ns': [0, SECOND, 2 * SECOND]}),
    ('too_far', {'extent_px': 15.0}),
    ('uncertain', {'std': 1.5}),
    ('too_far', {'std': 1.5, 'extent_px': 30.0}),
    ('implausible', {'speeds': (20.0, 20.0, -1.0, 20.0, 20.0)}),
    ('implausible', {'speeds': (20.0, 20.0, 40.0, 20.0, 20.0)}),
    ('implausible', {'speeds': (95.0,) * 5}),
    ('implausible', {'speeds': (0.2,) * 5, 'std': 0.2}),  # nothing that moves
])
def test_each_reason_for_rejection(reason, changes):
    result = conclude(found(**changes), rig(), EXACT)
    assert (result.verdict, result.reason) == (Verdict.REJECTED, reason)
    assert result.speed_mps is None and result.smoothed == {}


@pytest.mark.parametrize('scatter_px, reason', [(0.1, ''), (0.2, 'views_disagree')])
def test_disparities_that_scatter_too_much_are_rejected(scatter_px, reason):
    scattered = found()
    solved = replace(scattered.solved, scatter_px=scatter_px)
    assert conclude(replace(scattered, solved=solved), rig(), EXACT).reason == reason


@pytest.mark.parametrize('reason, column, values', [
    ('off_path', 2, [0.0, 0.2, 0.4, 0.6, 0.8]), ('views_disagree', None, 0.4)])
def test_each_image_based_reason_for_rejection(reason, column, values):
    one = found()
    if column is None:
        solved = changed(one.solved, cross_ncc=np.full(5, values))
    else:
        mean = one.solved.posterior.mean.copy()
        mean[:, column] = values
        solved = changed(one.solved, mean=mean)
    assert conclude(replace(one, solved=solved), rig(), EXACT).reason == reason


def test_pass_of_a_too_uncertain_rig_is_rejected():
    turned = found()
    lane = replace(turned.lane, scale_std=0.004)
    assert conclude(replace(turned, lane=lane), rig(), EXACT).reason == 'rig_uncertain'
    loose = replace(EXACT, max_scale_std_share=0.01)
    assert conclude(replace(turned, lane=lane), rig(), loose).verdict is Verdict.MEASURED


def test_pass_in_which_the_clock_was_set_is_rejected():
    one = found()
    solved = replace(one.solved, clock_set=True)
    assert conclude(replace(one, solved=solved), rig(), EXACT).reason == 'stamps_uncertain'


def test_standing_vehicle_that_drifts_is_as_certain_as_one_that_does_not():
    """Its speed is 0.02 m/s along the path, on a bend, and 0.05 across it."""
    followed = found((0.0, 0.02, -0.02), std=0.2)
    posterior = replace(followed.solved.posterior, lateral_mps=np.array([0.0, 0.05, 0.05]),
                        path_scale=np.full(3, 0.9))
    np.testing.assert_allclose(posterior.ground_stds(), 0.18)
