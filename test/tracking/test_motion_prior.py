# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The motion models against a Kalman smoother, closed forms and quadrature."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.estimation.gaussian import condition
from stereo_speed.tracking.motion_prior import (
    headings, lateral_rates, motion_models, MotionModel, PassMotion, PassPrior, persistent_moves,
    StateIndex)

TIMES_S = np.array([0.0, 0.2, 0.35, 0.8, 1.0, 1.2])  # uneven on purpose
RATE, S_STD, V_STD, MEASURE_STD = 0.4, 2.0, 5.0, 0.3


def kalman_smoother(measured):
    """Return the textbook Rauch-Tung-Striebel smoother of (s, v), speed a Wiener process."""
    x, P = np.array([1.0, 20.0]), np.diag([S_STD ** 2, V_STD ** 2])
    H, R = np.array([[1.0, 0.0]]), np.array([[MEASURE_STD ** 2]])
    filtered, predicted, steps = [], [], []
    for k, y in enumerate(measured):
        if k:
            dt = TIMES_S[k] - TIMES_S[k - 1]
            F = np.array([[1.0, dt], [0.0, 1.0]])
            Q = RATE ** 2 * np.array([[dt ** 3 / 3, dt ** 2 / 2], [dt ** 2 / 2, dt]])
            x, P = F @ x, F @ P @ F.T + Q
            steps.append(F)
            predicted.append((x, P))
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x, P = x + K @ (y - H @ x), (np.eye(2) - K @ H) @ P
        filtered.append((x, P))
    out = [filtered[-1]]
    for k in range(len(measured) - 2, -1, -1):
        G = filtered[k][1] @ steps[k].T @ np.linalg.inv(predicted[k][1])
        out.insert(0, (filtered[k][0] + G @ (out[0][0] - predicted[k][0]),
                       filtered[k][1] + G @ (out[0][1] - predicted[k][1]) @ G.T))
    return out


def pass_motion(stamp_std_s=0.0, **changes):
    prior = PassPrior(s_m=1.0, s_std_m=S_STD, offset_m=np.zeros(2), offset_slope=np.zeros(2),
                      speed_mps=20.0, speed_std_mps=V_STD, heading_std_rad=np.full(2, 1e-3))
    return PassMotion(prior, TrackerConfig(**changes), stamp_std_s)


def measurements(n):
    measured = 3 + 19 * TIMES_S + np.random.default_rng(2).normal(0, MEASURE_STD, n)
    info, right = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
    info[range(0, 3 * n, 3), range(0, 3 * n, 3)] = MEASURE_STD ** -2
    right[::3] = measured / MEASURE_STD ** 2
    return measured, info, right


def test_motion_model_equals_the_kalman_smoother_of_its_process():
    n = len(TIMES_S)
    measured, info, right = measurements(n)
    standing = np.zeros((n, 4))  # no heading error to share
    prior, = pass_motion().equations(TIMES_S, standing, [MotionModel(1.0, RATE, False, 0.03)])
    found = condition(prior, info, right)
    mean, covariance = found.mean, found.covariance
    for k, (x, P) in enumerate(kalman_smoother(measured)):
        at = [3 * k, 3 * n + k]
        np.testing.assert_allclose(mean[at], x, rtol=1e-6)
        np.testing.assert_allclose(covariance[np.ix_(at, at)], P, rtol=1e-5, atol=1e-9)


def test_changing_speed_is_an_integrated_wiener_process():
    """Covariances of (s, v, a) at any two times in closed form, s(0), v(0), a(0) independent."""
    n, jerk, a_std = len(TIMES_S), 3.0, 1.5
    motion = pass_motion(jerk_rate_std=jerk, acceleration_std_mps2=a_std)
    prior, = motion.equations(TIMES_S, np.zeros((n, 4)), [MotionModel(1.0, None, False, 0.03)])
    covariance = np.linalg.inv(prior.H)
    for k, t in enumerate(TIMES_S):
        F = np.array([[1, t, t * t / 2], [0, 1, t], [0, 0, 1]])
        Q = jerk ** 2 * np.array([[t ** 5 / 20, t ** 4 / 8, t ** 3 / 6],
                                  [t ** 4 / 8, t ** 3 / 3, t ** 2 / 2],
                                  [t ** 3 / 6, t ** 2 / 2, t]])
        want = F @ np.diag([S_STD ** 2, V_STD ** 2, a_std ** 2]) @ F.T + Q
        index = StateIndex(n)
        at = [index.poses[k, 0], index.speeds[k], index.accelerations[k]]
        np.testing.assert_allclose(covariance[np.ix_(at, at)], want, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize('fps', [5.0, 60.0])
def test_noise_free_processes_with_exact_stamps_can_be_solved(fps):
    """With every rate 0 a constant speed remains, or a constant acceleration."""
    motion = pass_motion(0.0, speed_rate_std=0.0, cruise_rate_std=0.0, jerk_rate_std=0.0,
                         acceleration_std_mps2=0.0, drift_across_std_m=0.0,
                         manoeuvre_across_std_m=0.0)
    times = np.arange(20) / fps
    info, right = np.zeros((60, 60)), np.zeros(60)
    info[range(0, 60, 3), range(0, 60, 3)], right[::3] = 1e6, 1e6 * (1.0 + 18 * times)
    state = np.tile([0.0, 0, 0, 18.0], (20, 1))
    for prior in motion.equations(times, state, motion_models(motion.config)):
        found = condition(prior, info, right)
        np.testing.assert_allclose(found.mean[60:80], 18.0, atol=0.02)
        assert np.all(np.diag(found.covariance) > 0)


def test_effect_of_stamp_jitter_equals_brute_force():
    """The sigma of the speed with 1 ms stamp jitter is that of measurements jittered alike."""
    n, v, jitter = len(TIMES_S), 20.0, 2e-3
    _, info, right = measurements(n)
    info[info > 0], state = 1e12, np.tile([0.0, 0, 0, v], (n, 1))
    state[:, 0] = 0.0
    prior, = pass_motion(jitter).equations(TIMES_S, state, [MotionModel(1.0, 1e-3, False, 0.03)])
    covariance = condition(prior, info, right * 0).covariance
    rng = np.random.default_rng(3)
    slopes = [np.polyfit(TIMES_S, v * rng.normal(0, jitter, n), 1)[0] for _ in range(4000)]
    assert np.sqrt(covariance[3 * n, 3 * n]) == pytest.approx(np.std(slopes), rel=0.06)


def test_persistent_moves_integrate_the_covariance_of_the_rate():
    """Over both intervals, by quadrature; the rate's covariance decays as exp(-|t - t'| / T)."""
    drift, persists = 1.3, 0.4
    fine = np.linspace(0.0, TIMES_S[-1], 1201)
    rate = drift ** 2 / (2 * persists) * np.exp(-np.abs(fine[:, None] - fine) / persists)
    middle = 0.25 * (rate[1:, 1:] + rate[:-1, 1:] + rate[1:, :-1] + rate[:-1, :-1])
    member = np.stack([(fine[:-1] >= a - 1e-9) & (fine[1:] <= b + 1e-9)
                       for a, b in zip(TIMES_S[:-1], TIMES_S[1:])]).astype(float)
    want = member @ middle @ member.T * (fine[1] - fine[0]) ** 2
    np.testing.assert_allclose(persistent_moves(TIMES_S, drift, persists), want, rtol=5e-3)


def test_persistent_moves_over_long_times_equal_the_drift():
    far = np.arange(5) * 1000.0
    np.testing.assert_allclose(persistent_moves(far, 1.3, 0.5), 1.3 ** 2 * 1000.0 * np.eye(4),
                               rtol=1e-3, atol=0.5)


@pytest.mark.parametrize('lasts_s', [2.0, 3.0, 5.0])
@pytest.mark.parametrize('fps', [5.0, 12.0])
def test_evidence_separates_a_lane_change_from_wandering(lasts_s, fps):
    """A smooth step of 3.5 m is a lane change, however slow; the lane's own drift is not."""
    times = np.arange(0.0, 5.8, 1 / fps)
    part = np.clip((times - 0.4) / lasts_s, 0.0, 1.0)
    change = 3.5 * part ** 3 * (10 - 15 * part + 6 * part ** 2)
    rng = np.random.default_rng(4)
    wander = np.cumsum(rng.normal(0.0, 0.1 * np.sqrt(1 / fps), len(times)))
    for offsets, changes in ((change, True), (wander, False)):
        logs = [condition(prior, *_offsets_seen(offsets, 0.01)).log_evidence
                for prior in pass_motion().equations(
                    times, np.zeros((len(times), 4)),
                    [MotionModel(1.0, RATE, model, 0.03) for model in (False, True)])]
        assert (logs[1] - logs[0] > np.log(100)) == changes
        assert (logs[0] > logs[1]) != changes


def _offsets_seen(offset_m, std_m):
    """Return the information of offsets measured with a 1-sigma."""
    n = len(offset_m)
    info, right = np.zeros(3 * n), np.zeros(3 * n)
    info[1::3] = std_m ** -2
    right[1::3] = offset_m * std_m ** -2
    return np.diag(info), right


@pytest.mark.parametrize('fps', [2.5, 10.0, 60.0])
def test_lateral_rates_of_a_parabola_are_exact(fps):
    t = np.arange(0, 2.0, 1 / fps)
    np.testing.assert_allclose(lateral_rates(t, 0.3 + 0.5 * t - 0.7 * t ** 2), 0.5 - 1.4 * t,
                               atol=1e-9)


def test_heading_is_the_direction_of_motion_and_zero_at_rest():
    state = np.array([[0.0, 0, 0, 20.0], [0, 0, 0, 0.5]])
    got = headings(state, np.array([2.0, 2.0]), np.array([0.5, 1.0]))
    np.testing.assert_allclose(got, [np.arctan2(2.0, 10.0), 0.0])


@pytest.mark.parametrize('changes, number', [
    ({}, 10), ({'manoeuvre_probability': 0.0}, 4), ({'cruise_share': 0.0}, 8),
    ({'smooth_share': 1.0}, 5),
    ({'manoeuvre_probability': 0.0, 'cruise_share': 1.0, 'smooth_share': 0.0}, 1)])
def test_model_shares_add_up_to_one_for_any_selection(changes, number):
    models = motion_models(TrackerConfig(**changes))
    assert len(models) == number
    assert sum(model.share for model in models) == pytest.approx(1.0)
    assert all(model.share > 0 for model in models)


def test_state_indices_are_disjoint_and_complete():
    at = StateIndex(4)
    parts = (at.poses, at.speeds, at.accelerations, at.heading_error,
             np.array(at.crossfall_error))
    assert sorted(np.concatenate([part.ravel() for part in parts])) == list(range(at.size))
