# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Measured, considered and limit speed; passes that are no violation, and the reasons."""
from __future__ import annotations

from dataclasses import fields, replace
from datetime import date

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.passes import PassResult, SecondEstimate, VehicleClass, VehicleKind, Verdict
from stereo_speed.core.records import InitialFront, TrackState, TrackUpdate
from stereo_speed.core.trace import OtherFront, PassTrace, TracePair
from stereo_speed.core.units import KMH_MPS, MPH_MPS
from stereo_speed.enforcement.config import DecisionConfig
from stereo_speed.enforcement.decision import (
    ambiguity, calibration_refusal, decide, limit_mps, NoRecord)
from stereo_speed.site.file import LaneSpec

ALONE = DecisionConfig(demand_second_estimate=False)
BOX = np.array([[100.0, 100], [200, 100], [200, 150], [100, 150]])


def passed(kmh, std_kmh=0.2, second=None, verdict=Verdict.MEASURED):
    """Return a pass with a speed."""
    return PassResult(
        track=0, lane='near', first_ns=0, last_ns=10 ** 9, pairs=10, speed_mps=kmh * KMH_MPS,
        speed_std_mps=std_kmh * KMH_MPS, verdict=verdict, reason='', smoothed={},
        smoothed_std={}, second=second)


def second(kmh, std_kmh=0.2):
    """Return a second estimate with a speed."""
    return SecondEstimate(kmh * KMH_MPS, std_kmh * KMH_MPS, 8)


@pytest.mark.parametrize(('kmh', 'measured', 'considered', 'refused'), [
    (88.7, 88, 85, None),  # 3 km/h off up to 100
    (83.9, 83, 80, NoRecord.BELOW_LIMIT),  # 80.9, rounded down, is not above 80
    (84.5, 84, 81, None),
    (84.05, 84, 81, None),  # 81.05 is 1.05 above the limit: more than 3 of 0.2
    (100.0, 100, 97, None),
    (130.0, 130, 126, None),  # 3 % of 130 are 3.9
    (179.9, 179, 174, None),
    (180.5, 180, 175, NoRecord.OUTSIDE_INTERVAL),
])
def test_three_speeds_by_hand(kmh, measured, considered, refused):
    figures, why = decide(passed(kmh), 80 * KMH_MPS, ALONE)
    assert (figures.measured, figures.considered, why) == (measured, considered, refused)
    assert figures.limit == 80


def test_mph_speeds_are_integers_where_the_speed_is():
    config = replace(ALONE, unit='mph', tolerance_kmh=0.0, tolerance_percent=0.0)
    result = replace(passed(1), speed_mps=60 * MPH_MPS)
    figures, why = decide(result, 55 * MPH_MPS, config)
    assert (figures.measured, figures.considered, figures.limit, why) == (60, 60, 55, None)


def test_considered_speed_never_exceeds_any_estimate_less_its_tolerance():
    rng = np.random.default_rng(3)
    for first, other in rng.uniform(20, 180, (300, 2)):
        figures, _ = decide(passed(first, second=second(other)), 50 * KMH_MPS, ALONE)
        lower = min(first, other)
        assert figures.considered <= lower - max(3.0, 0.03 * lower) + 1e-6
        assert figures.considered <= figures.measured <= lower + 1e-6


@pytest.mark.parametrize(('result', 'limit_kmh', 'changes', 'refused'), [
    (passed(90, verdict=Verdict.REJECTED), 80, {}, NoRecord.NOT_MEASURED),
    (passed(90), None, {}, NoRecord.NO_LIMIT),
    (passed(90), 80, {'demand_second_estimate': True}, NoRecord.NO_SECOND_ESTIMATE),
    (passed(90, second=SecondEstimate(None, None, 0)), 80, {'demand_second_estimate': True},
     NoRecord.NO_SECOND_ESTIMATE),
    (passed(90, second=second(87.9)), 80, {}, NoRecord.SECOND_DISAGREES),  # 2.1 apart
    (passed(90, second=second(89.0)), 80, {}, NoRecord.SECOND_DISAGREES),  # 3.5 sigmas
    (passed(90, 1.0, second(89.0, 1.0)), 80, {}, None),
    (passed(84.5, 1.0), 80, {}, NoRecord.WITHIN_MARGIN),  # 81.5 less 3 sigmas
    (passed(84.5, 1.0), 80, {'margin_sigmas': 1.0}, None),
    (passed(88), 80, {'threshold_kmh': 6.0}, NoRecord.BELOW_LIMIT),
    (passed(19), 10, {}, NoRecord.OUTSIDE_INTERVAL),
], ids=str)
def test_reasons_for_no_record(result, limit_kmh, changes, refused):
    limit = None if limit_kmh is None else limit_kmh * KMH_MPS
    assert decide(result, limit, replace(ALONE, **changes))[1] is refused


def test_second_estimate_is_required_unless_configured_otherwise():
    assert decide(passed(90), 80 * KMH_MPS, DecisionConfig())[1] is NoRecord.NO_SECOND_ESTIMATE
    assert decide(passed(90, second=second(90)), 80 * KMH_MPS, DecisionConfig())[1] is None


def test_interval_must_not_be_empty():
    with pytest.raises(InputError, match='least_kmh: found 90.0, wanted less than most_kmh'):
        DecisionConfig(least_kmh=90.0, most_kmh=90.0)


def trace(*others, gap_ns=100_000_000, state=TrackState.CONFIRMED):
    """Return the trace of four pairs; the third contains other vehicles."""
    update = TrackUpdate(0, 0, 'near', state, 20.0, 0.1, 5.0, 0.0, np.zeros(3), np.eye(3),
                         np.eye(3), BOX, BOX + [-30, 0])
    pairs = tuple(TracePair(k * gap_ns, k * gap_ns, None, None, replace(update, stamp_ns=k),
                            others if k == 2 else ()) for k in range(4))
    return PassTrace(0, 0, 'near', InitialFront(0, BOX, BOX), 400, None, pairs)


def doubt(one, config=DecisionConfig(), left_out=()):
    """Return the ambiguity of its vehicle, if all pairs but some are measured from."""
    measured = {pair.stamp_ns for pair in one.pairs} - {one.pairs[k].stamp_ns for k in left_out}
    return ambiguity(one, measured, config)


@pytest.mark.parametrize(('shift_px', 'refused'), [
    ([0, 0], NoRecord.AMBIGUOUS), ([120, 0], NoRecord.AMBIGUOUS), ([126, 0], None),
    ([0, 60], NoRecord.AMBIGUOUS), ([0, -63], None), ([-300, 200], None)], ids=str)
def test_nearby_other_front_makes_the_vehicle_doubtful(shift_px, refused):
    other = OtherFront(1, BOX + shift_px, BOX + [2000, 0])
    assert doubt(trace(other)) is refused
    other = OtherFront(1, BOX + [2000, 0], BOX + [-30, 0] + shift_px)
    assert doubt(trace(other)) is refused


def test_evidence_must_last_a_minimum_time():
    assert doubt(trace(gap_ns=10_000_000)) is NoRecord.TOO_SHORT
    assert doubt(trace(state=TrackState.COASTING)) is NoRecord.TOO_SHORT
    assert doubt(trace(state=TrackState.TENTATIVE)) is NoRecord.TOO_SHORT
    assert doubt(trace(), left_out=[0]) is None
    assert doubt(trace(), left_out=[0, 1, 3]) is NoRecord.TOO_SHORT
    assert doubt(trace()) is None


HEAVY_80 = LaneSpec('near', 'a', 'b', None, 100 * KMH_MPS,
                    {VehicleClass.HEAVY_VEHICLE: 80 * KMH_MPS})
FAST_MOTORCYCLES = LaneSpec('far', 'b', 'c', None, 90 * KMH_MPS,
                            {VehicleClass.MOTORCYCLE: 120 * KMH_MPS})


@pytest.mark.parametrize(('lanes', 'kind', 'probability', 'kmh'), [
    (('near',), VehicleClass.HEAVY_VEHICLE, 0.99, 80),
    (('near',), VehicleClass.HEAVY_VEHICLE, 0.9, 100),  # in doubt
    (('near',), VehicleClass.CAR, 0.99, 100), (('near',), VehicleClass.UNKNOWN, 0.99, 100),
    (('near',), None, 0.0, 100), (('far',), VehicleClass.CAR, 0.99, 90),
    (('far',), VehicleClass.UNKNOWN, 0.6, 120),  # it may be a motorcycle
    (('near', 'far'), VehicleClass.HEAVY_VEHICLE, 0.99, 90),  # it changed lanes
    (('near', 'nowhere'), VehicleClass.CAR, 0.99, None)], ids=str)
def test_limit_depends_on_the_class(lanes, kind, probability, kmh):
    vehicle = None if kind is None else VehicleKind(kind, probability, 1.8, 0.05)
    found = limit_mps((HEAVY_80, FAST_MOTORCYCLES), lanes, vehicle, DecisionConfig())
    assert found == (None if kmh is None else pytest.approx(kmh * KMH_MPS))


DAY_NS = 86_400 * 10 ** 9
CALIBRATED = date(2026, 1, 1)
NEW_YEAR_NS = 1_767_225_600 * 10 ** 9  # that day, 0:00 UTC


@pytest.mark.parametrize(('calibrated', 'days', 'changes', 'refused'), [
    (CALIBRATED, 0, {}, None), (CALIBRATED, 365, {}, None),
    (CALIBRATED, 366, {}, NoRecord.CALIBRATION_EXPIRED),
    (CALIBRATED, 366, {'calibration_months': 13.0}, None),
    (CALIBRATED, -1, {}, None),  # its day begins earlier in the east than in UTC
    (CALIBRATED, -2, {}, NoRecord.CALIBRATION_EXPIRED),  # after the pass
    (None, 0, {}, None),
    (None, 0, {'demand_calibration_date': True}, NoRecord.CALIBRATION_EXPIRED)], ids=str)
def test_calibration_expires(calibrated, days, changes, refused):
    config = replace(DecisionConfig(), **changes)
    assert calibration_refusal(calibrated, NEW_YEAR_NS + days * DAY_NS, config) is refused


def outcomes(config):
    """Return the decisions on some passes at the edges of every parameter."""
    passes = [passed(kmh, std, other) for kmh in (19, 84.05, 90, 130, 185) for std in (0.2, 0.5)
              for other in (None, second(kmh), second(kmh + 1), second(kmh - 2.5, 3.0))]
    decisions = [decide(one, limit * KMH_MPS, config) for one in passes for limit in (10, 80)]
    near = OtherFront(1, BOX + [120, 0], BOX + [2000, 0])
    traces = [doubt(one, config) for one in (trace(near), trace(gap_ns=45_000_000))]
    ages = [calibration_refusal(day, NEW_YEAR_NS + 366 * DAY_NS, config)
            for day in (CALIBRATED, None)]
    lorry = VehicleKind(VehicleClass.HEAVY_VEHICLE, 0.9, 2.5, 0.05)
    return decisions, traces, ages, limit_mps((HEAVY_80,), ('near',), lorry, config)


@pytest.mark.parametrize(('name', 'value'), [
    ('unit', 'mph'), ('tolerance_kmh', 4.0), ('tolerance_percent', 4.0), ('margin_sigmas', 5.5),
    ('threshold_kmh', 5.0), ('least_kmh', 15.0), ('most_kmh', 190.0),
    ('demand_second_estimate', False), ('second_sigmas', 1.0), ('second_apart_kmh', 3.0),
    ('least_class_probability', 0.8),
    ('calibration_months', 13.0), ('demand_calibration_date', True), ('clear_share', 0.1),
    ('evidence_span_s', 0.1)])
def test_every_decision_parameter_changes_some_outcome(name, value):
    assert outcomes(replace(DecisionConfig(), **{name: value})) != outcomes(DecisionConfig())


def test_all_decision_parameters_are_tested():
    swept = {name for mark in
             test_every_decision_parameter_changes_some_outcome.pytestmark
             for name, _ in mark.args[1]}
    assert swept == {field.name for field in fields(DecisionConfig)}
