# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Traffic statistics, by hand."""
from __future__ import annotations

from datetime import timezone

import numpy as np
import pytest
from stereo_speed.core.units import MPH_MPS
from stereo_speed.survey.traffic import pace, traffic_figures, traffic_groups, Vehicle

HOUR_NS = 3600 * 10 ** 9


def vehicle(mph, lane='near', hour=7, limit_mph=30.0, **how):
    return Vehicle(first_ns=hour * HOUR_NS, last_ns=hour * HOUR_NS + 10 ** 9, lane=lane,
                   speed_mps=None if mph is None else mph * MPH_MPS, limit_mps=None
                   if limit_mph is None else limit_mph * MPH_MPS, **how)


def test_figures_by_hand():
    f = traffic_figures([vehicle(mph) for mph in (20.0, 25.0, 28.0, 31.0, 46.0)]
                        + [vehicle(None), vehicle(50.0, limit_mph=None)])
    assert (f.passes, f.measured, f.limited) == (7, 6, 5)
    mph = np.array([20, 25, 28, 31, 46, 50.0])
    assert f.mean_mps / MPH_MPS == pytest.approx(mph.mean())
    assert f.std_mps / MPH_MPS == pytest.approx(mph.std(ddof=1))
    assert f.median_mps / MPH_MPS == pytest.approx(29.5)
    assert f.p85_mps / MPH_MPS == pytest.approx(46 + 0.25 * 4)  # place 4.25 of 0 to 5
    assert (f.pace_low_mps / MPH_MPS, f.pace_share) == pytest.approx((25.0 - 5, 0.5))
    assert f.over_share == pytest.approx(2 / 5)


def test_pace_contains_most_vehicles():
    rng = np.random.default_rng(0)
    speeds = np.sort(rng.normal(20, 4, 300))
    low, share = pace(speeds)
    brute = max(np.mean((speeds >= a) & (speeds <= a + 10 * MPH_MPS)) for a in speeds)
    assert share == pytest.approx(brute)
    assert np.mean((speeds >= low) & (speeds <= low + 10 * MPH_MPS)) == pytest.approx(share)


def test_groups():
    some = [vehicle(20.0, direction='receding'), vehicle(None, 'far', 8), vehicle(40.0, 'far', 8)]
    groups = {(g.by, g.group): g.figures for g in traffic_groups(some, timezone.utc)}
    assert list(groups) == [('all', 'all'), ('lane', 'far'), ('lane', 'near'),
                            ('direction', 'receding'), ('hour', '07'), ('hour', '08')]
    assert (groups['lane', 'far'].passes, groups['lane', 'far'].measured) == (2, 1)
    assert groups['hour', '08'].over_share == 1.0
    assert sum(f.passes for (by, _), f in groups.items() if by == 'lane') == 3


def test_nothing_measured_has_no_figures():
    f = traffic_figures([vehicle(None)])
    assert (f.passes, f.measured, f.mean_mps, f.over_share) == (1, 0, None, None)
    assert traffic_figures([vehicle(30.0)]).std_mps is None
