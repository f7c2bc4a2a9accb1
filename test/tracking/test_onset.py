# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Vehicles of constant speed until they brake, against solving each onset separately."""
from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from scipy.special import logsumexp
from stereo_speed.estimation.gaussian import condition, NormalEquations
from stereo_speed.tracking.motion_prior import StateIndex
from stereo_speed.tracking.onset import (
    changes, Moments, Onsets, Unnoticed, unnoticed, with_onsets)

TIMES_S = np.array([0.0, 0.1, 0.4, 0.45])  # the second interval is long: it has parts
COUNT, AT = len(TIMES_S), StateIndex(len(TIMES_S))
RATE, ONSETS = 0.3, Onsets(per_s=0.4, lasts_s=1.5, std_mps2=4.0)
WAYS = 0.02 ** 2 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]])


def speeds_and_ways(begins_s, ends_s):
    """Return the effect of an acceleration of 1 m/s^2 on speeds and positions at all times."""
    lasted_s = np.clip(TIMES_S - begins_s, 0.0, ends_s - begins_s)
    return lasted_s, 0.5 * lasted_s ** 2 + lasted_s * np.maximum(TIMES_S - ends_s, 0.0)


def solved(speeds_mps, std_mps, braked_s=None, places_m=None):
    """Return the solution from positions, without onset or with the acceleration as last state."""
    size, s, v = AT.steady, AT.poses[:, 0], AT.speeds
    prior = NormalEquations(size + (braked_s is not None))
    for k in range(size):
        prior.row([k], [1.0], 20.0 * (k in v), 5.0 if k == v[0] else 1e4)
    gaps_s, gained_mps, beside_m = np.diff(TIMES_S), np.zeros(3), np.zeros(3)
    if braked_s is not None:
        speeds, places = speeds_and_ways(*braked_s)
        gained_mps = np.diff(speeds)
        beside_m = np.diff(places) - gaps_s * (speeds[1:] + speeds[:-1]) / 2
        prior.row([size], [1.0], 0.0, ONSETS.std_mps2)
    last = np.full(3, prior.H.shape[0] - 1)
    ones = np.ones(3)
    prior.rows(np.column_stack([v[1:], v[:-1], last]),
               np.column_stack([ones, -ones, -gained_mps]), RATE * np.sqrt(gaps_s))
    prior.correlated(
        np.column_stack([s[1:], s[:-1], v[1:], v[:-1], last]),
        np.column_stack([ones, -ones, -gaps_s / 2, -gaps_s / 2, -beside_m]), WAYS)
    if places_m is None:
        places_m = np.append(0.0, np.cumsum(gaps_s * (speeds_mps[1:] + speeds_mps[:-1]) / 2))
    H, right = np.zeros(size), np.zeros(size)
    H[s], H[v] = 0.03 ** -2, std_mps ** -2
    right[s], right[v] = places_m / 0.03 ** 2, speeds_mps / std_mps ** 2
    return condition(prior, np.diag(H), right)


def found(speeds_mps, std_mps, rate_factor=1.0):
    steady = solved(np.asarray(speeds_mps), std_mps)
    may = changes(TIMES_S, AT, np.linalg.inv(WAYS), RATE)
    return steady, with_onsets(steady, may, ONSETS, rate_factor)


@pytest.mark.parametrize('speeds_mps', [(20.0, 20.1, 19.2, 18.8), (20.0, 19.2, 18.6, 18.6)])
@pytest.mark.parametrize('std_mps', [0.05, 1.0])
@pytest.mark.parametrize('rate_factor', [1.0, 3.0])
def test_mixture_equals_the_separately_solved_onsets(speeds_mps, std_mps, rate_factor):
    """
    At each pair and twice between pairs, ended at any later one of these times or not yet.

    In the long run a vehicle is changing its speed for ``lasts_s * per_s`` of the time that it is
    not, so one that does not yet do so in its first pair, and then does not begin to, has a
    probability of exp(-per_s * 0.45) / (1 + lasts_s * per_s).  Changes do not overlap.
    """
    steady, mixed = found(speeds_mps, std_mps, rate_factor)
    gaps_s = np.array([0.1, 0.1, 0.1, 0.1, 0.05])
    begins_s = TIMES_S[0] + np.append(0.0, np.cumsum(gaps_s))
    expected = ONSETS.per_s * (gaps_s + np.array([ONSETS.lasts_s, 0.0, 0.0, 0.0, 0.0]))
    answers, log_shares = [steady], [steady.log_evidence]
    for i, begin_s in enumerate(begins_s[:-1]):
        for j in range(i + 1, len(begins_s)):
            one = solved(np.asarray(speeds_mps), std_mps, (begin_s, begins_s[j]))
            answers.append(one)
            log_shares.append(
                one.log_evidence + np.log(rate_factor * expected[i])
                - (begins_s[j] - begin_s) * (1 / ONSETS.lasts_s - ONSETS.per_s)
                + (np.log(gaps_s[j] / ONSETS.lasts_s) if j < len(gaps_s) else 0.0))
    log_shares = np.array(log_shares) - ONSETS.per_s * TIMES_S[-1] \
        - np.log1p(ONSETS.per_s * ONSETS.lasts_s)
    weights = np.exp(log_shares - logsumexp(log_shares))
    means = np.array([one.mean[:AT.steady] for one in answers])
    mean = weights @ means
    covariance = sum(w * (one.covariance[:AT.steady, :AT.steady] + np.outer(m - mean, m - mean))
                     for w, m, one in zip(weights, means, answers))
    seen = np.append(AT.poses[:, 0], AT.speeds)
    np.testing.assert_allclose(mixed.mean[seen], mean[seen], atol=1e-6)
    np.testing.assert_allclose(mixed.covariance[np.ix_(seen, seen)],
                               covariance[np.ix_(seen, seen)], atol=1e-7)
    assert mixed.log_evidence == pytest.approx(logsumexp(log_shares), abs=1e-5)


@pytest.mark.parametrize('per_s, lasts_s', [(0.4, 1.5), (1e-3, 1.5), (3.0, 2.0)])
def test_all_ways_of_driving_have_a_total_probability_of_one(per_s, lasts_s):
    """
    Where data say nothing, the evidence of the mixture is the share of drivers that it counts.

    Left out are those who begin a change after another one.  They are counted here by following
    many drivers through 0.3 s.
    """
    times_s = np.linspace(0.0, 0.3, 301)
    may = changes(times_s, StateIndex(301), np.eye(300), RATE)
    silent = replace(may, pull=0 * may.pull, own=0 * may.own)
    nothing = Moments(np.zeros(may.pull.shape[1]), np.eye(may.pull.shape[1]), 0.0)
    rng, drivers = np.random.default_rng(0), 20_000
    changes_s = rng.exponential(lasts_s, drivers)  # from now on, however long it has lasted
    begins_s = np.where(rng.random(drivers) < per_s * lasts_s / (1 + per_s * lasts_s),
                        0.0, rng.exponential(1 / per_s, drivers))
    again_s = begins_s + changes_s + rng.exponential(1 / per_s, drivers)
    counted = np.mean(again_s > 0.3)
    mixed = with_onsets(nothing, silent, Onsets(per_s, lasts_s, 4.0))
    assert math.exp(mixed.log_evidence) == pytest.approx(counted, abs=0.01)


def test_vehicle_that_brakes_already_is_found_in_its_first_pairs():
    """It is no less likely to be braking when it is first seen than at any later time."""
    rates = 20.0 - 3.0 * TIMES_S
    steady = solved(rates, 0.05)
    may = changes(TIMES_S, AT, np.linalg.inv(WAYS), RATE)
    mixed = with_onsets(steady, may, ONSETS)
    onset = with_onsets(steady, replace(may, earlier=np.zeros(len(may.earlier), bool)), ONSETS)
    assert abs(mixed.mean[AT.speeds[0]] - 20.0) < abs(onset.mean[AT.speeds[0]] - 20.0)
    assert mixed.log_evidence > onset.log_evidence + 0.5


def test_newest_speed_is_less_certain_than_without_onsets():
    """Nothing shows yet whether it has started to brake."""
    steady, mixed = found((20.0,) * 4, 1.0)
    assert mixed.covariance[AT.speeds[3], AT.speeds[3]] \
        > steady.covariance[AT.speeds[3], AT.speeds[3]] * 1.03
    assert mixed.mean[AT.speeds[3]] == pytest.approx(steady.mean[AT.speeds[3]], abs=0.05)


@pytest.mark.parametrize('per_s, lasts_s', [(0.4, 1e9), (3.0, 1e9)])
def test_unnoticed_change_is_the_error_of_a_solved_braking_vehicle(per_s, lasts_s):
    """
    Exact positions and speeds of vehicles braking since a given time, solved as usual.

    Changes last so long that none has ended.
    """
    onsets = Onsets(per_s, lasts_s, std_mps2=4.0)
    may = changes(TIMES_S, AT, np.linalg.inv(WAYS), RATE)
    begins_s = [0.0, 0.1, 0.2, 0.3, 0.4, 0.45]
    newest, left_mps, growing = int(AT.speeds[-1]), [], []
    for part in range(1, 5):
        for begin_s in begins_s:
            braking = 6.0 * part / 4
            speeds, places = speeds_and_ways(begin_s, np.inf)
            steady = solved(20.0 - braking * speeds, 0.3, places_m=20.0 * TIMES_S
                            - braking * places)
            mixed = with_onsets(steady, may, onsets)
            left_mps.append(abs(20.0 - braking * speeds[-1] - mixed.mean[newest]))
            growing.append(braking)
    known = solved(np.full(COUNT, 20.0), 0.3)
    found = unnoticed(known, may, onsets, newest, 6.0)
    assert found.speed_mps == pytest.approx(left_mps, abs=1e-6)
    # A change that begins now is unknown; one that began long ago is partly known.
    assert found.rate_mps2[5::6] == pytest.approx(growing[5::6])
    assert (found.rate_mps2 <= np.array(growing) + 1e-9).all() and found.rate_mps2[0] < 1.4
    assert found.after(0.0) == pytest.approx(max(left_mps))
    assert found.after(10.0) == pytest.approx(60.0, rel=0.05)


def test_whole_change_is_unnoticed_where_no_onset_is_expected():
    may, newest = changes(TIMES_S, AT, np.linalg.inv(WAYS), RATE), int(AT.speeds[-1])
    found = unnoticed(solved(np.full(COUNT, 20.0), 0.3), may, Onsets(0.0, 1.5, 1.0), newest, 6.0)
    left_mps = []
    for begin_s in (0.0, 0.1, 0.2, 0.3, 0.4, 0.45):
        speeds, places = speeds_and_ways(begin_s, np.inf)
        steady = solved(20.0 - 6.0 * speeds, 0.3, places_m=20.0 * TIMES_S - 6.0 * places)
        left_mps.append(abs(20.0 - 6.0 * speeds[-1] - steady.mean[newest]))
    assert found.speed_mps[-6:] == pytest.approx(left_mps, abs=1e-6)
    assert found.rate_mps2[-6:] == pytest.approx(6.0)


def test_least_sensitive_of_several_views_determines_unnoticed():
    views = [Unnoticed(np.array([mps]), np.array([mps2]))
             for mps, mps2 in ((1.0, 2.0), (0.5, 4.0))]
    both = Unnoticed.any_of(views, 6.0)
    assert [both.after(t) for t in (0.0, 0.3, 1.0)] == pytest.approx([1.0, 1.8, 6.0])
    assert Unnoticed.any_of([], 6.0).after(0.5) == 3.0
