# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Acceptance of received calibrations."""
from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest

pytest.importorskip('rclpy')

from sensor_msgs.msg import CameraInfo  # noqa: E402

from stereo_speed.nodes.calibration import CalibrationWatch  # noqa: E402
from stereo_speed.nodes.health import ERROR, OK, Refusals, State, WARN  # noqa: E402


class Clock:
    """A monotonic clock that a test advances."""

    def __init__(self):
        self.s = 0.0

    def __call__(self):
        return self.s


def info(side, f_px=1500.0):
    msg = CameraInfo(width=640, height=480, distortion_model='plumb_bob', d=[0.0] * 5)
    msg.k = np.array([f_px, 0, 320, 0, f_px, 240, 0, 0, 1.0])
    msg.r = np.eye(3).ravel()
    tx = -0.5 * f_px if side == 'right' else 0.0
    msg.p = np.array([f_px, 0, 320, tx, 0, f_px, 240, 0, 0, 0, 1.0, 0])
    return msg


@pytest.fixture()
def clock():
    return Clock()


@pytest.fixture()
def watch(clock):
    return CalibrationWatch(Refusals(lambda line: None, clock), clock)


def level(watch):
    state = State('fine')
    watch.tell(state)
    return state.level


def both(watch, f_px=1500.0):
    for side in ('left', 'right'):
        watch.take(side, info(side, f_px))


def test_both_calibrations_make_the_rig_and_a_later_bad_one_is_ignored(watch):
    assert level(watch) == WARN
    both(watch)
    version, rig = watch.current
    assert (version, rig.baseline_m) == (1, pytest.approx(0.5)) and level(watch) == OK
    bad = info('left')
    bad.k = np.full(9, np.nan)
    watch.take('left', bad)
    watch.take('left', CameraInfo())
    assert watch.current == (1, rig) and not watch.doubtful
    assert watch._refusals.tally.total == 2


def test_uncalibrated_driver_is_waited_for(watch, clock):
    watch.take('left', CameraInfo(width=640, height=480))
    assert watch.current == (0, None)
    clock.s += 6.0
    assert level(watch) == ERROR
    both(watch)
    assert watch.current[0] == 1 and level(watch) == OK


def test_changed_calibration_is_accepted_when_repeated(watch):
    both(watch)
    for _ in range(2):
        both(watch, 1515.0)
        assert watch.doubtful and watch.current[0] == 1 and level(watch) == WARN
    both(watch, 1515.0)
    version, rig = watch.current
    assert version == 2 and rig.left.K[0, 0] == rig.right.K[0, 0] == 1515.0
    assert not watch.doubtful and level(watch) == OK


def test_single_changed_calibration_is_accepted_if_not_contradicted(watch, clock):
    both(watch)
    both(watch, 1515.0)
    clock.s += 1.1
    watch.settle()
    assert watch.current[0] == 2


def test_known_calibration_ends_the_doubt(watch):
    both(watch)
    watch.take('left', info('left', 1515.0))
    assert watch.doubtful
    watch.take('left', info('left'))
    assert not watch.doubtful and watch.current[0] == 1


@pytest.mark.parametrize(('order', 'every_s'), [
    ((1515.0, 1500.0), 0.1), ((1515.0, 1515.0, 1515.0, 1500.0, 1500.0, 1500.0), 0.05),
    ((1515.0, 1500.0), 1.25), ((1515.0, 1530.0), 0.1),
    (tuple(1500.0 + k for k in range(1, 60)), 0.1)])
def test_calibrations_that_change_again_and_again_are_an_error(watch, clock, order, every_s):
    """As of two drivers on one topic, with the known one among them or not; seen at any moment."""
    both(watch)
    levels = []
    while clock.s < 20.0:
        both(watch, order[len(levels) % len(order)])
        clock.s += every_s
        watch.settle()
        levels.append(level(watch))
    assert levels[0] == WARN or every_s > 1.0
    assert set(levels[len(levels) // 2:]) == {ERROR}
    clock.s += 11.0
    watch.settle()
    assert level(watch) == OK


def test_two_faulty_messages_of_both_sides_are_no_error(watch, clock):
    both(watch)
    for _ in range(2):
        both(watch, 1515.0)
        assert level(watch) == WARN
        both(watch)
        clock.s += 2.0
        assert level(watch) == OK


def test_rig_is_valid_from_its_calibration_to_the_next_doubt(watch):
    """Never for a pair between the doubt and the new rig."""
    assert watch.holds(0)
    both(watch)
    assert watch.holds(1) and not watch.holds(0)
    held = []
    making = watch._make

    def make():
        held.append([watch.holds(1), watch.holds(2)])
        making()
        held.append([watch.holds(1), watch.holds(2)])
    watch._make = make
    for _ in range(3):
        both(watch, 1515.0)
        held.append([watch.holds(1), watch.holds(2)])
    assert held == [[False, False]] * 4 + [[False, True]]


def test_swapped_cameras_make_no_rig(watch):
    watch.take('left', info('right'))
    watch.take('right', deepcopy(info('left')))
    assert watch.current[1] is None and level(watch) == ERROR
