# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Two-wheelers: fronts that are narrow, and alone on the road."""
from __future__ import annotations

from drawn_fronts import Front, LANE_M, LANES, pair_of, RIG, SPEED_MPS, START_M, STEP_NS
import numpy as np
import pytest
from stereo_speed.detection.config import DetectorConfig, FrontConfig, SpacingConfig
from stereo_speed.detection.detector import PlaneSweepDetector
from stereo_speed.detection.outline import Extent
from stereo_speed.detection.protocol import TrackedRegion
from stereo_speed.detection.spacing import Held, Lengths, MovingBeside, Place, Spacing
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import SplinePath, StraightPath

STEP_M = SPEED_MPS * STEP_NS * 1e-9


def test_narrow_front_is_found_in_the_second_pair():
    detector = PlaneSweepDetector(RIG, LANES, DetectorConfig())
    found = [detector.update(pair_of([Front(20.0 + k * STEP_M, half_m=0.4)], k))
             for k in range(2)]
    assert not found[0]
    (one,) = found[1]
    assert one.width_m < 1.2
    assert one.s_m == pytest.approx(20.0 + STEP_M, abs=0.5)
    assert one.speed_mps == pytest.approx(SPEED_MPS, rel=0.05)


@pytest.mark.parametrize('limits', [
    {'narrow_least_m': 1.0}, {'narrow_low_m': 0.8}, {'narrow_high_m': 0.7}])
def test_narrow_front_limits_are_parameters(limits):
    def seen(front):
        detector = PlaneSweepDetector(RIG, LANES, DetectorConfig(front=front))
        return [(one.s_m, one.width_m, one.left_px.tolist()) for k in range(2)
                for one in detector.update(pair_of(
                    [Front(20.0 + k * STEP_M, half_m=0.25)], k))]
    assert seen(FrontConfig(**limits)) != seen(FrontConfig())


def test_stationary_object_is_no_two_wheeler():
    detector = PlaneSweepDetector(RIG, LANES, DetectorConfig())
    assert not any(detector.update(pair_of([Front(20.0, half_m=0.4)], k)) for k in range(3))


def test_part_of_a_wide_front_is_no_two_wheeler():
    detector = PlaneSweepDetector(RIG, LANES, DetectorConfig())
    wide = [Front(20.0 + k * STEP_M, symmetric=False) for k in range(3)]
    assert not any(detector.update(pair_of([front], k)) for k, front in enumerate(wide))


def test_narrow_front_need_not_be_symmetric():
    detector = PlaneSweepDetector(RIG, LANES, DetectorConfig())
    found = [detector.update(pair_of([Front(20.0 + k * STEP_M, half_m=0.35, symmetric=False)], k))
             for k in range(2)]
    (one,) = found[1]
    assert one.width_m == pytest.approx(0.7, abs=0.2)
    assert one.lateral_m == pytest.approx(0, abs=0.1)


def held(width_m, s_m, x_m=0.0):
    """Return the region of a track of a vehicle."""
    return TrackedRegion(lane='lane', s_m=s_m, lateral_m=x_m, width_m=width_m, height_m=0.6,
                         left_px=np.zeros((4, 2)), right_px=np.zeros((4, 2)))


@pytest.mark.parametrize(('ahead_m', 'x_m', 'width_m', 'limits', 'is_found'), [
    (14.0, 1.2, 2.5, {}, False),  # at the side of a lorry
    (14.0, 1.2, 2.5, {'narrow_behind_m': 12.0}, True),
    (14.0, 1.9, 2.5, {'narrow_side_m': 0.8}, False),
    (14.0, 1.9, 2.5, {}, True),
    (14.0, 0.0, 2.5, {}, True),  # behind its middle
    (14.0, 1.0, 1.8, {}, True),  # beside a car, which is not so long
    (14.0, 1.0, 1.8, {'narrow_behind_car_m': 16.0}, False),
    (14.0, 1.0, 1.8, {'narrow_car_width_m': 1.7}, False),
    (5.0, 1.0, 1.8, {}, False),  # at the side of a car
    (25.0, 1.2, 2.5, {}, True)])
def test_object_at_the_side_of_a_long_vehicle_is_part_of_it(
        ahead_m, x_m, width_m, limits, is_found):
    detector = PlaneSweepDetector(RIG, LANES, DetectorConfig(front=FrontConfig(**limits)))
    for k in range(2):
        s_m = 12.0 + k * STEP_M
        found = detector.update(pair_of([Front(s_m, half_m=0.35)], k),
                                [held(width_m, s_m + ahead_m, x_m)])
    assert bool(found) == is_found


@pytest.mark.parametrize('goes_away', [False, True])
def test_side_of_a_vehicle_lies_beyond_the_end_facing_the_camera(goes_away):
    """The rear of a receding vehicle is tracked, so a rider ahead of it is at its side."""
    sense = 1.0 if goes_away else -1.0
    path = StraightPath(np.array([0.0, 2.0, 50.0 - 40 * sense]), np.array([0.0, 0.0, sense]),
                        80.0, np.array([0.0, -1.0, 0.0]))
    spacing = Spacing({'lane': LanePath('lane', path, None, np.zeros(2), 0.0)}, SpacingConfig())
    lorry = Place(np.array([0.0, 2.0, 40.0]), 1.25)
    found = [spacing.is_at_side('lane', Place(np.array([1.2, 2.0, z_m]), 0.35), [lorry], 18.0, 0.5)
             for z_m in (30.0, 50.0)]
    assert found == [False, True]


@pytest.mark.parametrize(('lane', 'against', 'at_side'), [
    ('', False, True), ('own', False, True), ('oncoming', False, False),
    ('oncoming', True, True), ('own', True, False)])  # these two overtake
def test_oncoming_object_is_no_part_of_a_vehicle(lane, against, at_side):
    down, up = np.array([0.0, 0.0, -1.0]), np.array([0.0, -1.0, 0.0])
    lanes = {name: LanePath(name, StraightPath(start_m, ahead, 80.0, up), None, np.zeros(2), 0.0)
             for name, start_m, ahead in (
                 ('own', np.array([0.0, 2.0, 90.0]), down),
                 ('oncoming', np.array([3.0, 2.0, 10.0]), -down))}
    lorry = Place(np.array([1.7, 2.0, 30.0]), 1.25, lane, against)
    rider = Place(np.array([0.2, 2.0, 40.0]), 0.35)
    assert Spacing(lanes, SpacingConfig()).is_at_side(
        'own', rider, [lorry], 18.0, 0.5) is at_side


@pytest.mark.parametrize('behind_m', [4.0, 6.0, 8.0])
@pytest.mark.parametrize(('tracked', 'limits'), [
    (True, {'apart_m': 100.0}), (False, {})], ids=['by its track', 'by both views'])
def test_two_wheeler_before_a_vehicle_in_the_next_lane_is_found(behind_m, tracked, limits):
    """Both move alike: the track of the other vehicle tells them apart, or its depth."""
    def found(*, tracked, **limits):
        detector = PlaneSweepDetector(RIG, LANES, DetectorConfig(front=FrontConfig(**limits)))
        for k in range(2):
            s_m = 20.0 + k * STEP_M
            other = Front(s_m - behind_m, x_m=3.0, light=1.3)
            out = detector.update(pair_of([other, Front(s_m, half_m=0.35)], k),
                                  [held(1.8, other.s_m, other.x_m)] if tracked else [])
        return out
    assert not found(tracked=False, apart_m=100.0)
    (one,) = found(tracked=tracked, **limits)
    assert one.s_m == pytest.approx(20.0 + STEP_M, abs=1.0)
    assert one.lateral_m == pytest.approx(0, abs=0.2)


def lane_of(sense):
    """Return a lane along z; a sense of -1 leads towards the cameras."""
    return LanePath('lane', StraightPath(
        np.array([0.0, 2.0, 50.0 - 40 * sense]), np.array([0.0, 0.0, sense]), 80.0,
        np.array([0.0, -1.0, 0.0])), None, np.zeros(2), 0.0)


def beside(near_m=0.35, most_m=1.7, left=True):
    """Return what moves with a front 0.7 m wide: it extends 2.32 m to one side of its middle."""
    ends = -0.35, 2.32, -0.35, near_m
    ends = ends if left else (-ends[1], -ends[0], -ends[3], -ends[2])
    return MovingBeside(Extent(*ends), -0.6, 0.6, most_m, Lengths(6.0, 18.0, 0.975))


@pytest.mark.parametrize('sense', [-1.0, 1.0], ids=['approaching', 'receding'])
@pytest.mark.parametrize('side', [-1.0, 1.0])
@pytest.mark.parametrize(('others', 'near_m', 'width_m'), [
    ([(4.0, 40.0, 1.0)], 0.35, 1.60),  # 18 m long; its rear is at 3 * 30 / 58 m
    ([(4.0, 40.0, 0.9)], 0.35, 2.07),  # 6 m long: 3.1 * 30 / 46 m
    ([(4.0, 40.0, 1.0)], 0.55, 1.60),  # a little beyond the edge of the front
    ([(4.0, 40.0, 1.0)], 0.70, 2.67),  # nothing static at its edge
    ([(2.1, 44.0, 1.0)], 0.35, 0.70),  # covers the middle of the front too
    ([(2.1, 44.0, 1.0)], 0.55, 0.90),
    ([(4.2, 34.5, 0.9), (2.2, 44.9, 0.8)], 0.35, 0.875),  # 1.4 * 30 / 50.9 m, by both
    ([(2.2, 44.9, 0.8), (4.2, 34.5, 0.9)], 0.35, 0.875),
    ([(3.0, 22.0, 0.9)], 0.35, 2.30),  # nearer; its rear is at 2.1 * 30 / 28 m
    ([(3.0, 20.0, 1.0)], 0.35, 1.63),  # 2 * 30 / 38 m
    ([(3.0, 22.0, 0.9)], 0.70, 2.67),  # nothing static at the edge of the front
    ([(3.0, 14.0, 1.0)], 0.35, 2.67),  # too much nearer
    ([(3.0, 28.0, 0.9)], 0.35, 2.67),  # too little
    ([(4.0, 24.0, 0.9)], 0.35, 2.67),  # seen beyond what moves
    ([(4.0, 32.0, 0.9)], 0.35, 2.67),  # side by side
    ([(1.8, 40.0, 0.9)], 0.35, 2.67),  # in the lane of the front
    ([(4.0, 46.0, 1.0)], 0.35, 2.67)])  # so far beyond it that it is seen above it
def test_vehicles_in_the_next_lane_are_no_part_of_a_narrow_front(
        others, near_m, width_m, side, sense):
    """
    By hand, for a front 30 m away.

    Vehicles count with their mirrors, 0.3 m on either side.
    """
    spacing = Spacing({'lane': lane_of(sense)}, SpacingConfig())
    front = Place(np.array([0.0, 2.0, 30.0]), 0.35, 'lane')
    places = [Place(np.array([side * x, 2.0, z]), half, 'lane') for x, z, half in others]
    left = side * sense < 0  # x is to the left of what approaches
    assert [spacing.stands_alone('lane', front, beside(near_m, width_m + more_m, left), places)
            for more_m in (-0.02, 0.02)] == [False, True]


@pytest.mark.parametrize('z_m', [-1.0, 0.0, 1.0])
def test_vehicle_that_has_passed_the_cameras_is_not_seen_beside_a_front(z_m):
    """Tracks are predicted beyond the view for a while."""
    spacing = Spacing({'lane': lane_of(-1.0)}, SpacingConfig())
    front = Place(np.array([0.0, 2.0, 12.0]), 0.35, 'lane')
    gone = Place(np.array([3.0, 2.0, z_m]), 0.9, 'lane')
    assert not spacing.stands_alone('lane', front, beside(), [gone])


def test_next_lane_of_a_bend_is_found_by_the_offsets_from_the_path():
    """On a circle of 50 m radius, 12 m of arc turn by 0.24 rad, and move aside by 1.4 m."""
    angles = np.linspace(0.0, 1.2, 61)
    points = np.stack([50.0 * (1 - np.cos(angles)), 2.0 + 0 * angles, 80 - 50.0 * np.sin(angles)],
                      axis=1)
    path = SplinePath(points, np.array([0.0, -1.0, 0.0]))
    spacing = Spacing({'lane': LanePath('lane', path, None, np.zeros(2), 0.0)}, SpacingConfig())

    def place(s_m, x_m, half_m):
        s = np.array(s_m)
        return Place(path.position(s) + x_m * path.frame(s)[:, 1], half_m, 'lane')
    found = [spacing._is_seen_beside('lane', place(40.0, 0.0, 0.35), place(28.0, x_m, 0.9))
             for x_m in (-3.5, -1.0, 0.0, 1.0, 3.5)]
    assert found == [True, False, False, False, True]


@pytest.mark.parametrize('oncoming', [False, True])
def test_oncoming_vehicle_does_not_move_alike(oncoming):
    lanes = {'lane': lane_of(-1.0), 'other': lane_of(1.0 if oncoming else -1.0)}
    front, other = Place(np.array([0.0, 2.0, 30.0]), 0.35), Place(
        np.array([4.0, 2.0, 40.0]), 1.0, 'other')
    assert Spacing(lanes, SpacingConfig()).stands_alone(
        'lane', front, beside(), [other]) is not oncoming


def test_front_of_which_nothing_moves_does_not_stand_alone():
    spacing = Spacing({'lane': lane_of(-1.0)}, SpacingConfig())
    front, other = (Place(np.array([x, 2.0, z]), half, 'lane')
                    for x, z, half in ((0.0, 30.0, 0.35), (4.0, 40.0, 1.0)))
    nothing = beside()._replace(extent=Extent(0.6, 2.32, 0.6, 0.35))
    assert not spacing.stands_alone('lane', front, nothing, [other])


def test_other_tracks_agree_if_they_leave_a_narrow_front_alone():
    spacing = Spacing({'lane': lane_of(-1.0)}, SpacingConfig())
    front = Place(np.array([0.0, 2.0, 30.0]), 0.35, 'lane')
    van, later = (Place(np.array([4.0, 2.0, z]), 1.0, 'lane') for z in (40.0, 39.5))
    asked = Held(spacing, [van])
    assert asked.stands_alone('lane', front, beside())
    assert spacing.agree(asked.asked, [later]) and not spacing.agree(asked.asked, [])


def test_length_of_a_two_wheeler_may_widen_its_image():
    """Seen from the side, objects behind a front appear wider by a part of their depth."""
    def found(length_m):
        detector = PlaneSweepDetector(RIG, LANES, DetectorConfig(
            front=FrontConfig(narrow_length_m=length_m, narrow_most_m=0.6,
                              least_width_m=1.5)))
        return [d for k in range(2) for d in detector.update(
            pair_of([Front(20.0 + k * STEP_M, half_m=0.42)], k))]
    assert LANE_M / (START_M - 20.0 - STEP_M) > 0.1
    assert not found(0.0) and found(1.5)
