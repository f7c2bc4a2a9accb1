# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Live data: the latest of everything, and its age."""
from __future__ import annotations

import pytest
from stereo_speed.studio.live import LiveHealth, LiveReading, LiveState, STALE_S


class Clock:
    """A clock that a test sets."""

    now = 100.0

    def __call__(self):
        return self.now


def test_received_data_is_reported_and_ages():
    clock = Clock()
    live = LiveState(clock)
    assert live.snapshot()['stale'] and live.snapshot()['age_s'] is None
    for number in range(6):
        clock.now += 0.2
        live.add_image('left', b'jpeg')
        live.add_reading(LiveReading('vehicle_1', number, 20.0 + number, 0.1))
    live.add_health(LiveHealth('tracker', 0, 'measuring'))
    live.add_pass({'track': 1, 'verdict': 'measured'})
    now = live.snapshot()
    assert not now['stale'] and now['views'] == {'left': 0.0}
    assert [r['speed_mps'] for r in now['readings']] == [20.0, 21.0, 22.0, 23.0, 24.0, 25.0]
    assert now['readings'][0]['age_s'] == pytest.approx(1.0)
    assert now['passes'] == [{'track': 1, 'verdict': 'measured'}]
    assert live.overlay('left') == b'jpeg' and live.overlay('right') is None
    clock.now += STALE_S + 0.1
    later = live.snapshot()
    assert later['stale'] and later['age_s'] == pytest.approx(STALE_S + 0.1)
    assert later['health'][0]['age_s'] == pytest.approx(STALE_S + 0.1)
    # an active node does not make old images and readings current
    live.add_pass({'track': 2, 'verdict': 'measured'})
    last = live.snapshot()
    assert not last['stale'] and last['views']['left'] == pytest.approx(STALE_S + 0.1)
    assert last['readings'][-1]['age_s'] == pytest.approx(STALE_S + 0.1)


def test_node_reports_only_its_own_state():
    live = LiveState(Clock())
    for level, name in ((0, 'a'), (1, 'b'), (2, 'a')):
        live.add_health(LiveHealth(name, level, 'm'))
    assert {h['name']: h['level'] for h in live.snapshot()['health']} == {'a': 2, 'b': 1}
