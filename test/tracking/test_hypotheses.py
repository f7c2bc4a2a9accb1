# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Hypotheses about a pass, by hand."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.tracking.hypotheses import (
    hypotheses_of, log_unchanged, of_kin, with_onset_to_come)


def drives(hypothesis):
    return hypothesis.motion.speed_rate_std, hypothesis.motion.changes_lanes


@pytest.mark.parametrize('cruise_share, walking', [(0.7, 1 / 0.3), (0.0, 1.0), (0.5, 2.0)])
def test_sustained_braking_matches_the_hypothesis_with_most_speed_noise(cruise_share, walking):
    """In one lane the cruising share counts with the others; in a lane change there is none."""
    config = TrackerConfig(cruise_share=cruise_share)
    shares = {drives(h): h.onsets for h in hypotheses_of(config)}
    assert shares.pop((config.cruise_rate_std, False), 0.0) == 0.0
    assert shares == pytest.approx({
        (config.speed_rate_std, False): walking, (None, False): 0.0,
        (config.speed_rate_std, True): 1.0, (None, True): 0.0})


def test_shares_are_those_of_a_mixture():
    assert sum(h.share for h in hypotheses_of(TrackerConfig())) == pytest.approx(1.0)


def test_kin_differ_only_in_the_random_walk_of_the_speed():
    """Each gets the greatest weight among those of the same scatter, lane and ride."""
    all_ = hypotheses_of(TrackerConfig())
    weights = np.random.default_rng(0).dirichlet(np.full(len(all_), 0.1))
    found = of_kin(all_, weights)
    for hypothesis, greatest in zip(all_, found):
        assert greatest == max(
            w for h, w in zip(all_, weights) if h.more_px == hypothesis.more_px
            and h.motion.changes_lanes == hypothesis.motion.changes_lanes
            and h.motion.ride_std_m == hypothesis.motion.ride_std_m)
    assert len(set(found)) == len(all_) // 2.5  # three walks in one lane, two in a change


def test_coming_onset_counts_like_a_changing_speed():
    """With all weight on one that changes its speed, only its kin are kept beside it."""
    all_ = hypotheses_of(TrackerConfig())
    changing = next(k for k, h in enumerate(all_) if h.motion.speed_rate_std is None)
    weights = np.eye(len(all_))[changing]
    np.testing.assert_array_equal(with_onset_to_come(all_, weights), of_kin(all_, weights))
    steady = next(k for k, h in enumerate(all_) if h.motion.speed_rate_std is not None)
    np.testing.assert_array_equal(
        with_onset_to_come(all_, np.eye(len(all_))[steady]), np.eye(len(all_))[steady])


def test_only_hypotheses_that_expect_onsets_doubt_that_the_speed_is_kept():
    """For 10 s at 0.3 onsets per second, and not before that either: 1 / (1 + 0.3 * 2)."""
    config = TrackerConfig(onset_per_s=0.3, onset_lasts_s=2.0)
    hypotheses = hypotheses_of(config)
    found = log_unchanged(config, hypotheses, np.array([0.0, 4.0, 10.0]))
    expected = [0.0 if h.motion.speed_rate_std is None else -3.0 - np.log(1.6)
                for h in hypotheses]
    np.testing.assert_allclose(found, expected)
    assert {0.0} < set(found)
    for times_s, other in ((np.zeros(1), config), (np.array([0.0, 9.0]), replace(
            config, onset_per_s=0.0))):
        assert not log_unchanged(other, hypotheses, times_s).any()
