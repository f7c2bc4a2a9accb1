# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A verification by hand, and the numbers of passes in the rules."""
from __future__ import annotations

import json
import re

import pytest
from scipy.stats import beta
from stereo_speed.core.units import KMH_MPS, SpeedUnit
from stereo_speed.io.survey_files import verification_json
from stereo_speed.report.survey import verification_page
from stereo_speed.survey.reference import (
    matched, passes_wanted, ReferenceSpeed, reliability_shown, verification)
from stereo_speed.survey.traffic import Vehicle

S = 10 ** 9


def reference(second, kmh, lane='near', std_kmh=0.3):
    return ReferenceSpeed(time_ns=round(second * S), lane=lane, speed_mps=kmh * KMH_MPS,
                          std_mps=std_kmh * KMH_MPS)


def measured(second, kmh, lane='near'):
    return Vehicle(first_ns=round(second * S), last_ns=round((second + 2) * S), lane=lane,
                   speed_mps=None if kmh is None else kmh * KMH_MPS, speed_std_mps=0.1,
                   reason='' if kmh is not None else 'uncertain')


def test_matches_are_one_to_one_in_a_lane_and_near_in_time():
    vehicles = [measured(10, 50), measured(12.5, 60), measured(10, 70, 'far'), measured(40, 80)]
    found = matched([reference(12.2, 60), reference(11, 50), reference(11, 50, 'other'),
                     reference(43.5, 80)], vehicles, 1.0)
    # Both first ones are near two passes; only this assignment fits both.
    assert [m.vehicle for m in found] == [vehicles[1], vehicles[0], None, None]
    assert matched([], vehicles, 1.0) == []
    assert matched([reference(11, 50)], [], 1.0)[0].vehicle is None


def test_figures_by_hand():
    found = verification(
        [reference(1, 50), reference(11, 100), reference(21, 200), reference(31, 80),
         reference(41, 60), reference(51, 60, std_kmh=0.6), reference(99, 60)],
        [measured(0, 51), measured(10, 97.1), measured(20, 205.9), measured(30, 83.1),
         measured(40, None), measured(50, 61), measured(70, 60)], 1.0)
    assert (found.counted, found.within, found.strangers) == (4, 3, 1)
    assert found.mean_mps / KMH_MPS == pytest.approx((1 - 2.9 + 5.9 + 3.1) / 4)
    assert found.worst_mps / KMH_MPS == pytest.approx(3.1)  # 5.9 is within 3 % of 200
    assert not found.is_within
    claims = {c.name: (c.wanted, c.missing) for c in found.claims}
    assert claims['approval'] == (500, 496) and claims['yearly'] == (30, 26)


def test_reference_must_be_better_than_a_third_of_the_limit():
    assert reference(0, 50, std_kmh=0.5).is_good_enough
    assert not reference(0, 50, std_kmh=0.51).is_good_enough
    assert reference(0, 200, std_kmh=1.0).is_good_enough


def test_numbers_given_by_the_rules():
    assert passes_wanted(0) == 1497
    assert reliability_shown(500, 0) == pytest.approx(0.994, abs=5e-4)
    assert reliability_shown(1497, 0) >= 0.998 > reliability_shown(1496, 0)


@pytest.mark.parametrize(('counted', 'failures'), [(100, 0), (2365, 1), (60, 7)])
def test_reliability_equals_clopper_and_pearson(counted, failures):
    exact = 1 - beta.ppf(0.95, failures + 1, counted - failures)
    assert reliability_shown(counted, failures) == pytest.approx(exact, abs=2e-6)
    wanted = passes_wanted(failures)
    assert reliability_shown(wanted, failures) >= 0.998 - 1e-6
    assert reliability_shown(wanted - 1, failures) < 0.998


def test_all_within_the_limit_but_the_mean_is_not():
    sound = [verification([reference(10 * k, 50) for k in range(9)],
                          [measured(10 * k, 50 + off) for k in range(9)], 1.0)
             for off in (0.5, 1.5)]
    assert [v.within for v in sound] == [9, 9]
    assert [v.is_within for v in sound] == [True, False]  # 1.5 km/h is more than a mean may be


def test_every_reference_vehicle_is_counted_once():
    """By hand: inaccurate references for a missed, a rejected and a measured vehicle."""
    found = verification(
        [reference(1, 50), reference(11, 50, std_kmh=0.6), reference(21, 50, std_kmh=0.6),
         reference(31, 50, std_kmh=0.6), reference(41, 50), reference(99, 50)],
        [measured(0, 51), measured(10, 51), measured(20, None), measured(40, None)], 1.0)
    assert (found.counted, found.without_pass, found.rejected, found.not_good_enough) \
        == (1, 2, 2, 1)
    told = json.loads(verification_json(found))
    assert (told['counted'], told['no_pass'], told['rejected'],
            told['reference_not_good_enough']) == (1, 2, 2, 1)
    page = re.sub(r'<[^>]*>', ' ', verification_page(found, SpeedUnit('km/h')))
    for name, count in (('errors counted', 1), ('no pass found', 2), ('pass rejected', 2),
                        ('reference too uncertain', 1)):
        assert re.search(rf'{name}\s+{count}\s', page)
