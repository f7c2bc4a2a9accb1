# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Boxes become fronts: on time and late, once each, and only where a vehicle drives."""
from __future__ import annotations

from dataclasses import replace

from drawn_fronts import depth_bound_m, Front, HALF_M, LANES, pair_of, RIG, SPEED_MPS
import numpy as np
import pytest
from stereo_speed.detection.box_detector import BoxConfig, BoxDetector
from stereo_speed.detection.detector import PlaneSweepDetector
from stereo_speed.detection.lane_geometry import LaneGeometry
from stereo_speed.detection.protocol import ImageBox, TakesBoxes, TrackedRegion
from stereo_speed.pipeline.registry import DETECTORS

STEP_M = 0.2 * SPEED_MPS
FIRST = Front(22.0, x_m=0.2)
GEOMETRY = LaneGeometry(RIG, LANES['lane'])
ROADSIDE = ImageBox(left_px=20.0, top_px=200.0, width_px=60.0, height_px=60.0)


def front_at(k, first=FIRST):
    return replace(first, s_m=first.s_m + k * STEP_M)


def box_of(front, off_px=(0.0, 0.0), score=0.9):
    """Return the box of a front and of the vehicle above it."""
    uv = GEOMETRY.project(np.array([front.s_m]), front.x_m + np.array([-HALF_M, HALF_M]),
                          np.array([1.5, 0.0]))[0].reshape(-1, 2) + off_px
    (left, top), (width, height) = uv.min(axis=0), np.ptp(uv, axis=0)
    return ImageBox(left_px=left, top_px=top, width_px=width, height_px=height, score=score)


@pytest.fixture(scope='module')
def pairs():
    return [pair_of([front_at(k)], k) for k in range(5)]


def detector_of(**changes):
    return BoxDetector(RIG, LANES, BoxConfig(**changes))


def check(found, k):
    """Compare a detection with the front of a pair."""
    true = front_at(k)
    assert found.lane == 'lane'
    assert abs(found.s_m - true.s_m) < depth_bound_m(GEOMETRY, true.s_m)
    assert abs(found.lateral_m - true.x_m) < 0.12
    px_per_m = GEOMETRY.rates(np.array([true.s_m - STEP_M]))
    std = 0.5 / (0.2 * float(np.abs(px_per_m.px_per_m * px_per_m.climb)[0]))
    assert abs(found.speed_mps - SPEED_MPS) < std + 0.02 * SPEED_MPS


def test_detector_is_registered_and_takes_boxes():
    assert DETECTORS.load('boxes') is BoxDetector
    assert isinstance(detector_of(), TakesBoxes)


@pytest.mark.parametrize('off_px', [(0.0, 0.0), (4.0, -3.0), (-4.0, 4.0)])
@pytest.mark.parametrize('late', [0, 1, 3])
def test_vehicle_is_found_at_its_current_place(pairs, late, off_px):
    detector = detector_of()
    found = []
    for k, pair in enumerate(pairs[:late + 2]):
        if k == late + 1:
            detector.offer(pairs[1].stamp_ns, [ROADSIDE, box_of(front_at(1), off_px)])
        found += detector.update(pair)
    one, = found
    check(one, late + 1)
    assert one.earlier.pairs == tuple(pairs[:late + 1])
    true = GEOMETRY.project(np.array([FIRST.s_m]), np.array([FIRST.x_m]), np.array([0.525]))
    for quad, uv in zip((one.earlier.left_px, one.earlier.right_px), true):
        assert np.abs(quad.mean(axis=0) - uv[0, 0, 0]).max() < 4.0
    assert detector.unmatched == 0


def test_same_pairs_and_boxes_give_the_same_fronts(pairs):
    runs = []
    for _ in range(2):
        detector = detector_of()
        detector.update(pairs[0])
        detector.offer(pairs[1].stamp_ns, [box_of(front_at(1))])
        runs.append(detector.update(pairs[1])[0])
    assert np.array_equal(runs[0].left_px, runs[1].left_px)
    assert runs[0].speed_mps == runs[1].speed_mps


def second_pair(pairs, boxes, tracked=(), **changes):
    detector = detector_of(**changes)
    detector.update(pairs[0])
    detector.offer(pairs[1].stamp_ns, boxes)
    return detector.update(pairs[1], tracked)


def test_two_boxes_of_one_vehicle_give_one_front(pairs):
    assert len(second_pair(pairs, [box_of(front_at(1)), box_of(front_at(1), (3.0, 2.0))])) == 1


def test_boxes_without_a_vehicle_give_nothing(pairs):
    empty = box_of(Front(8.0))
    assert second_pair(pairs, [ROADSIDE, empty, replace(ROADSIDE, top_px=-300.0)]) == []
    assert second_pair(pairs, []) == []


def test_stationary_object_is_no_vehicle(pairs):
    still = [pairs[0], pair_of([FIRST], 1)]
    assert second_pair(still, [box_of(FIRST)]) == []


def test_unlikely_box_is_ignored(pairs):
    assert second_pair(pairs, [box_of(front_at(1), score=0.4)]) == []
    assert len(second_pair(pairs, [box_of(front_at(1), score=0.4)], least_score=0.3)) == 1


def test_box_on_a_tracked_vehicle_is_ignored(pairs):
    one, = second_pair(pairs, [box_of(front_at(1))])
    region = TrackedRegion(lane=one.lane, s_m=one.s_m, lateral_m=one.lateral_m,
                           width_m=one.width_m, height_m=one.height_m, left_px=one.left_px,
                           right_px=one.right_px)
    assert second_pair(pairs, [box_of(front_at(1))], [region]) == []


def test_late_box_on_a_vehicle_tracked_by_now_is_ignored(pairs):
    detector = detector_of()
    for pair in pairs[:2]:
        detector.update(pair)
    detector.offer(pairs[1].stamp_ns, [box_of(front_at(1))])
    now = front_at(2)
    region = TrackedRegion(lane='lane', s_m=now.s_m, lateral_m=now.x_m, width_m=1.8, height_m=0.5,
                           left_px=np.zeros((4, 2)), right_px=np.zeros((4, 2)))
    assert detector.update(pairs[2], [region]) == []


def test_asymmetric_front_is_found_by_its_box_alone():
    lopsided = [pair_of([front_at(k, replace(FIRST, symmetric=False))], k) for k in range(2)]
    one, = second_pair(lopsided, [box_of(front_at(1))])
    assert abs(one.s_m - front_at(1).s_m) < depth_bound_m(GEOMETRY, one.s_m) + 0.3
    sweep = PlaneSweepDetector(RIG, LANES, PlaneSweepDetector.Settings(least_symmetry=0.9))
    assert [sweep.update(pair) for pair in lopsided] == [[], []]


def test_boxes_of_unknown_or_forgotten_pairs_are_counted(pairs):
    detector = detector_of(history_pairs=1)
    detector.offer(pairs[0].stamp_ns - 5, [ROADSIDE])  # of no pair
    for pair in pairs[:3]:
        detector.update(pair)
    assert detector.unmatched == 1
    detector.offer(pairs[0].stamp_ns, [box_of(FIRST)])  # two pairs late at the next one, and more
    detector.offer(pairs[4].stamp_ns, [box_of(front_at(4))])
    assert detector.update(pairs[3]) == [] and detector.unmatched == 2
    assert len(detector.update(pairs[4])) == 1 and detector.unmatched == 2


def test_reset_forgets_pairs_and_boxes(pairs):
    detector = detector_of()
    detector.update(pairs[0])
    detector.offer(pairs[1].stamp_ns, [box_of(front_at(1))])
    detector.reset()
    assert detector.update(pairs[1]) == []
    detector.offer(pairs[2].stamp_ns, [box_of(front_at(2))])
    assert len(detector.update(pairs[2])) == 1


def test_gap_forgets_pairs(pairs):
    assert second_pair([pairs[0], replace(
        pairs[1], stamp_ns=pairs[1].stamp_ns + 4_000_000_000,
        right_stamp_ns=pairs[1].stamp_ns + 4_000_000_000)], [box_of(front_at(1))]) == []
