# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A moved rig stops the measurement until it is back in place, or its motion is known."""
from __future__ import annotations

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.logging import get_logger  # noqa: E402, I100
from stereo_speed.core.records import StereoPair  # noqa: E402
from stereo_speed.nodes import rig_watch  # noqa: E402
from stereo_speed.nodes.health import ERROR, OK, WARN  # noqa: E402
from stereo_speed.nodes.rig_watch import RigWatch  # noqa: E402
from stereo_speed.pipeline.config import SiteConfig  # noqa: E402
from stereo_speed.pipeline.look_process import LookProcess, LookProcessError  # noqa: E402
from stereo_speed.site.refine.rig_state import RigState  # noqa: E402

LOOK_S = 60.0
UNKNOWN, VAGUE = 200, 201  # grey levels of pairs without information, and with little


class Given:
    """Stands in for the parameters of a node."""

    def __init__(self, **values):
        self.values = values

    def get(self, name, default, *_):
        """Return the given value of a parameter."""
        return self.values.get(name, default)


class Log:
    """Records log lines."""

    def __init__(self):
        self.lines = []
        self.info = self.error = self.lines.append


class Brightness:
    """
    A stand-in for the process of a look.

    The brightness of the pairs is the share in percent, and the stance.
    """

    def __init__(self):
        self.grey, self.turns, self.state, self.closed = [], 0, None, False

    def lay(self, pair):
        """Store what a check needs of a pair."""
        assert self.state is None
        self.grey.append(pair.left[0, 0])

    def is_ready(self):
        """Return whether it has started; true from the second call on."""
        self.turns += 1
        return self.turns > 1

    def look(self, used, config, followed, suspected):
        """Start a check of the pairs so far."""
        assert self.turns > 1
        grey = float(np.mean(self.grey))
        self.state = RigState(grey / 100, 'lane', f'{len(self.grey)}', stance=grey,
                              confirmed=suspected == grey)
        if grey == UNKNOWN:
            self.state = RigState(None, '', 'not known')
        if grey == VAGUE:
            self.state = RigState(0.003, 'lane', '0.3 ± 2 %', std_share=0.02)

    def found(self):
        """Return the result, or fail."""
        if self.grey[0] == 255:
            raise LookProcessError('too bright')
        return self.state

    def close(self, most_s):
        """End it, once."""
        assert not self.closed
        self.closed = True


class NeverReady(Brightness):
    """A process that does not start."""

    def is_ready(self):
        """Return False."""
        return False


class NeverOver(Brightness):
    """A process whose check does not end."""

    def found(self):
        """Report that the check is in progress."""


class Dead(Brightness):
    """A process that was killed."""

    def found(self):
        """Fail like a process that has ended."""
        raise BrokenPipeError('it has ended')


def place():
    """Return a stand-in for a site."""
    return SimpleNamespace(site=None, rig=None, lanes={})


def watch(make=Brightness, log=None):
    """Return a watch that has started."""
    out = RigWatch(Given(rig_check_interval_s=0.01, rig_check_pairs=2, rig_check_spread_s=0.0),
                   log or Log(), make)
    out.begin(place(), SiteConfig())
    return out


def looked(watch, grey):
    """Show pairs of a brightness until a check is over."""
    before, end_s = (watch.looks, watch.failure), time.monotonic() + LOOK_S
    while (watch.looks, watch.failure) == before:
        assert time.monotonic() < end_s
        image = np.full((2, 2), grey, np.uint8)
        watch.take(StereoPair(0, 0, 0, image, image))
        time.sleep(0.01)


def test_stream_that_ends_before_the_process_is_ready_is_still_checked():
    """The pairs are stored, and the next one may be late."""
    rig, image = watch(), np.full((2, 2), 2, np.uint8)
    for k in range(2):
        rig.take(StereoPair(k, k, k, image, image))
    assert rig.looks == 0
    assert rig.state().level == OK  # now it is ready, and the look is requested
    assert rig.state().level == ERROR and rig.looks == 1


def test_readings_of_a_moved_rig_are_withheld_until_it_is_right():
    rig = watch()
    assert not rig.withholds and rig.state().level == OK
    for grey, level in ((0, OK), (2, ERROR), (1, OK)):
        looked(rig, grey)
        assert (rig.withholds, rig.state().level) == (level == ERROR, level)
    assert rig.log.lines == ['2'] * 3
    looked(rig, 255)  # a failed check says nothing about the rig
    assert not rig.withholds and rig.state().level == WARN
    rig.close()


def shown(watch, grey=0, pairs=5):
    """Show some pairs of a brightness, without waiting."""
    image = np.full((2, 2), grey, np.uint8)
    for _ in range(pairs):
        watch.take(StereoPair(0, 0, 0, image, image))


@pytest.mark.parametrize('make', [NeverReady, NeverOver])
def test_slow_look_is_waited_for_and_a_hung_one_is_soon_repeated(make):
    """A check may take minutes on a busy machine, but a hanging one is not given that time."""
    makes, now_s = [make, Brightness], [0.0]
    given = Given(rig_check_interval_s=600.0, rig_check_pairs=2, rig_check_spread_s=0.0)
    rig = RigWatch(given, Log(), lambda: makes.pop(0)(), lambda: now_s[0])
    rig.begin(place(), SiteConfig())
    for now_s[0] in (0.0, 1200.0):
        shown(rig)
        assert not rig.failure
    now_s[0] = 1900.0
    shown(rig)
    assert rig.state().level == WARN and 'failed' in rig.failure and len(makes) == 1
    now_s[0] = 1950.0
    shown(rig)
    assert len(makes) == 1  # not at once, because it may take memory or time
    now_s[0] = 1961.0
    shown(rig)
    assert rig.looks == 1 and rig.state().level == OK
    now_s[0] = 2500.0
    shown(rig)
    assert rig.looks == 1  # only after the interval, as after a finished check


def test_look_of_a_dead_process_has_failed_and_the_next_is_taken():
    makes = [Dead, Brightness]
    rig = watch(lambda: makes.pop(0)())
    looked(rig, 2)
    assert rig.state().level == WARN and rig.looks == 0
    looked(rig, 0)
    assert rig.looks == 1 and rig.state().level == OK


def test_process_that_cannot_be_started_is_a_failed_look():
    def no_more():
        raise BlockingIOError('no more processes')
    rig = watch(no_more)
    looked(rig, 2)
    assert rig.state().level == WARN and 'no more processes' in rig.state().message


def test_pairs_of_an_abandoned_look_are_in_no_other():
    rig = watch()
    image = np.full((2, 2), 2, np.uint8)
    rig.take(StereoPair(0, 0, 0, image, image))
    rig.begin(place(), SiteConfig())
    looked(rig, 0)
    assert not rig.withholds and rig.log.lines == ['2']


@pytest.mark.slow
def test_process_killed_during_a_look_is_replaced_for_the_next():
    made = []

    def make():
        made.append(LookProcess(10))
        return made[-1]
    rig = watch(make)
    image, end_s = np.zeros((2, 2), np.uint8), time.monotonic() + LOOK_S
    while not made:
        rig.take(StereoPair(0, 0, 0, image, image))
    made[0].process.kill()
    while not rig.failure:
        assert time.monotonic() < end_s
        rig.take(StereoPair(0, 0, 0, image, image))
        time.sleep(0.01)
    assert rig.state().level == WARN and made[0].process.wait(LOOK_S) < 0
    while len(made) < 2:
        assert time.monotonic() < end_s
        rig.take(StereoPair(0, 0, 0, image, image))
    rig.close()
    assert made[1].process.wait(LOOK_S) < 0


def test_rotation_found_alike_in_two_successive_looks_is_corrected():
    rig = watch()
    for grey in (2, 3):  # each check finds another pose
        looked(rig, grey)
        assert rig.withholds and rig.pop_correction() is None
    looked(rig, 3)
    assert rig.pop_correction() == 3 and rig.pop_correction() is None
    rig.begin(place(), SiteConfig(), 'it was off')
    assert not rig.withholds and rig.state().level == WARN
    assert 'it was off' in rig.state().message
    looked(rig, 0)
    assert rig.state().level == WARN  # the site is still another
    rig.close()


@pytest.mark.parametrize('grey', [UNKNOWN, VAGUE])
def test_look_that_is_not_conclusive_does_not_end_withholding(grey):
    rig = watch()
    looked(rig, 2)
    looked(rig, grey)
    assert rig.withholds and rig.state().level == ERROR
    looked(rig, 2)  # as found by the check before
    assert rig.pop_correction() == 2
    looked(rig, 0)
    assert not rig.withholds
    looked(rig, grey)
    assert not rig.withholds and rig.state().level == OK


def test_agreeing_looks_with_a_correct_one_between_correct_nothing():
    rig = watch()
    for grey in (2, 0, 2):
        looked(rig, grey)
        assert rig.pop_correction() is None
    assert rig.withholds


def test_rig_is_checked_unless_disabled():
    assert RigWatch(Given(), Log(), Brightness).interval_s == 600.0


@pytest.mark.parametrize(('given', 'wanted'), [({}, 10), ({'rig_check_niceness': 3}, 3)])
def test_process_of_a_check_gives_way_as_told(given, wanted, monkeypatch):
    started = []

    class Recorded(Brightness):
        def __init__(self, patience):
            started.append(patience)
            super().__init__()
    monkeypatch.setattr(rig_watch, 'LookProcess', Recorded)
    rig = RigWatch(Given(**given), Log())
    rig.begin(place(), SiteConfig())
    image = np.zeros((2, 2), np.uint8)
    rig.take(StereoPair(0, 0, 0, image, image))
    assert started == [wanted]


def test_changed_rig_is_checked_anew():
    rig = watch()
    looked(rig, 2)
    assert rig.withholds
    rig.begin(place(), SiteConfig())
    assert not rig.withholds


def test_rig_is_not_checked_where_checks_are_disabled():
    rig = RigWatch(Given(rig_check_interval_s=0.0), Log(), Brightness)
    rig.begin(place(), SiteConfig())
    for _ in range(20):
        rig.take(StereoPair(0, 0, 0, np.zeros((2, 2)), np.zeros((2, 2))))
    assert rig.looks == 0 and not rig.withholds and rig.state().level == OK


def test_look_that_sees_nothing_is_no_fault_of_the_rig():
    assert not RigState(None, '', 'dark').is_off
    assert RigState(math.inf, '', 'gone').is_off


@pytest.mark.parametrize(('share', 'std_share', 'turned', 'off'), [
    (0.004, 0.0009, True, True),  # a turned camera, however small its effect
    (0.004, 0.0011, True, False),
    (0.004, 0.0009, False, False),
    (0.015, 0.0015, False, True),
    (0.015, 0.0098, False, False),  # from a clicked site, or a check with few details
    (0.2, 0.05, False, True),
])
def test_rig_is_off_only_beyond_its_uncertainty(share, std_share, turned, off):
    assert RigState(share, 'lane', '', std_share, turned).is_off == off


def test_results_of_both_kinds_are_logged():
    """The loggers of rclpy refuse two severities from one place in the code."""
    rig = watch(log=get_logger('rig'))
    for grey in (0, 2, 1, 2):
        looked(rig, grey)
        assert rig.withholds == (grey == 2) and not rig.failure
