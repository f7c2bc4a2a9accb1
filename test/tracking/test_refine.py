# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The least-squares problem behind the refinement, against a Kalman smoother and scipy."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from scipy import stats

from stereo_speed.config import TrackerConfig
from stereo_speed.filtering.gaussian import condition, NormalEquations
from stereo_speed.tracking.refine import PassPrior, PassRefiner

TIMES_S = np.array([0.0, 0.2, 0.35, 0.8, 1.0, 1.2])  # uneven on purpose
RATE, S_STD, V_STD, MEASURE_STD = 0.4, 2.0, 5.0, 0.3


def kalman_smoother(measured):
    """Rauch-Tung-Striebel smoother of (s, v), speed a Wiener process, textbook form."""
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


def refiner_with_times():
    prior = PassPrior(s_m=1.0, s_std_m=S_STD, offset_m=np.zeros(2), offset_slope=np.zeros(2),
                      speed_mps=20.0, speed_std_mps=V_STD, heading_std_rad=np.full(2, 1e-3))
    refiner = PassRefiner(SimpleNamespace(), prior, TrackerConfig())
    refiner.pairs = [SimpleNamespace(stamp_ns=round(t * 1e9)) for t in TIMES_S]
    refiner.looks = [SimpleNamespace()] * len(TIMES_S)
    refiner.state = np.zeros((len(TIMES_S), 4))  # standing still: no heading error to share
    return refiner


def test_motion_model_is_the_kalman_smoother_of_the_same_process():
    n = len(TIMES_S)
    measured = 3 + 19 * TIMES_S + np.random.default_rng(2).normal(0, MEASURE_STD, n)
    info, right = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
    info[range(0, 3 * n, 3), range(0, 3 * n, 3)] = MEASURE_STD ** -2
    right[::3] = measured / MEASURE_STD ** 2
    mean, covariance, _ = condition(refiner_with_times()._motion(RATE, 0.2), info, right)
    for k, (x, P) in enumerate(kalman_smoother(measured)):
        at = [3 * k, 3 * n + k]
        np.testing.assert_allclose(mean[at], x, rtol=1e-6)
        np.testing.assert_allclose(covariance[np.ix_(at, at)], P, rtol=1e-5, atol=1e-9)


def test_evidence_differs_between_priors_as_the_marginal_density_does():
    rng = np.random.default_rng(5)
    A, noise = rng.normal(size=(7, 3)), 0.5
    y = rng.normal(size=7)
    logs, densities = [], []
    for std in (0.3, 1.0, 4.0):
        prior = NormalEquations(3)
        for k in range(3):
            prior.row([k], [1.0], 0.0, std)
        logs.append(condition(prior, A.T @ A / noise ** 2, A.T @ y / noise ** 2)[2])
        cov = std ** 2 * A @ A.T + noise ** 2 * np.eye(7)
        densities.append(stats.multivariate_normal(np.zeros(7), cov).logpdf(y))
    np.testing.assert_allclose(np.diff(logs), np.diff(densities), rtol=1e-9)
