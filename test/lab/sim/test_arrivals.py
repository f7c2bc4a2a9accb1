# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Traffic flow: no collisions, no braking beyond the limit, and planned manoeuvres happen."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereo_speed.core.errors import InputError
from stereo_speed.lab.sim import RoadConfig, SimConfig, TrafficConfig
from stereo_speed.lab.sim.arrivals import HARDEST_MPS2, STEP_S, TrafficFlow
from stereo_speed.lab.sim.kinematics import smooth_step

WINDOW, LEAVE = (225.0, 280.0), 320.0


def _flow(config, seed, lanes=3):
    return TrafficFlow(config, {k: WINDOW for k in range(lanes)},
                       {k: LEAVE for k in range(lanes)}, np.random.default_rng(seed))


def _run(flow, until_s, step_s=0.1):
    while flow.time_s < until_s:
        flow.advance(flow.time_s + step_s + 1e-9)
        yield flow.time_s, list(flow.drivers)


@pytest.mark.parametrize('seed', range(4))
def test_no_vehicles_collide_and_all_drive_past(seed):
    # Twice the usual density, and every vehicle has a plan.
    config = TrafficConfig(minutes=4.0, vehicles=160, change_share=0.4, brake_share=0.5,
                           follow_share=0.5)
    seen, changed, hardest = set(), {}, 0.0
    for t_s, drivers in _run(_flow(config, seed), 300.0):
        seen |= {d.number for d in drivers}
        for lane in range(3):
            here = sorted((d for d in drivers if lane in d.lanes(t_s)), key=lambda d: d.x_m)
            for behind, ahead in zip(here, here[1:]):
                assert ahead.x_m - ahead.body.length_m - behind.x_m > 0.5
        for d in drivers:
            assert d.v_mps >= 0
            hardest = max(hardest, abs(d.a_mps2))
            if d.done is not None:
                changed[d.number] = d.done
    assert seen == set(range(160))
    assert 4.0 < hardest <= HARDEST_MPS2
    assert len(changed) > 20
    assert {c.to_lane - c.from_lane for c in changed.values()} == {-1, 1}
    assert all(2.0 <= c.last_s <= 6.0 for c in changed.values())


def test_position_is_the_integral_of_the_speed():
    flow = _flow(TrafficConfig(minutes=1.0, vehicles=20, brake_share=1.0), 0)
    before, slowest, steps = {}, 99.0, 0
    for _, drivers in _run(flow, 40.0, STEP_S):
        for d in drivers:
            if d.number in before:
                x, v = before[d.number]
                # Exact where the acceleration is constant.
                assert d.x_m - x == pytest.approx((v + d.v_mps) / 2 * STEP_S, abs=1e-9)
                steps += 1
            before[d.number] = d.x_m, d.v_mps
            slowest = min(slowest, d.v_mps / d.cruise_mps)
            # Between two steps as well.
            half, _ = flow.place(d, flow.time_s + STEP_S / 2)
            assert half - d.x_m == pytest.approx(
                d.v_mps * STEP_S / 2 + d.a_mps2 * (STEP_S / 2) ** 2 / 2)
    assert len(before) == 20 and steps > 2000 and slowest < 0.8


def test_followers_keep_their_headway_behind_a_slow_vehicle():
    config = TrafficConfig(
        scene=SimConfig(road=RoadConfig(lanes=1)), minutes=2.0, vehicles=30, follow_share=0.9,
        change_share=0.0, brake_share=0.0)
    gaps = []
    for _, drivers in _run(_flow(config, 1, lanes=1), 100.0):
        here = sorted(drivers, key=lambda d: d.x_m)
        gaps += [(a.x_m - a.body.length_m - b.x_m) / b.v_mps for b, a in zip(here, here[1:])]
    assert np.percentile(gaps, 1) > 0.8  # the least headway asked for is 0.9 s
    assert np.median(gaps) < 3.0


def test_no_lane_change_into_an_oncoming_lane():
    config = TrafficConfig(scene=SimConfig(road=RoadConfig(lanes=3, receding=(2,))))
    assert config.same_way(0, 1) and not config.same_way(1, 2) and not config.same_way(2, 3)
    busy = replace(config, minutes=2.0, vehicles=80, change_share=1.0)
    changes = {(d.done.from_lane, d.done.to_lane) for _, drivers in _run(_flow(busy, 0), 140.0)
               for d in drivers if d.done is not None}
    assert changes == {(0, 1), (1, 0)}


def test_smooth_step_by_hand():
    assert smooth_step(-1.0) == (0.0, 0.0) and smooth_step(2.0) == (1.0, 0.0)
    assert smooth_step(0.5) == pytest.approx((0.5, 1.875))
    h = 1e-6
    for s in (0.1, 0.37, 0.9):
        slope = (smooth_step(s + h)[0] - smooth_step(s - h)[0]) / (2 * h)
        assert smooth_step(s)[1] == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize('field, value', [
    ('minutes', 0.0), ('vehicles', 0), ('hardest_g', 0.9), ('headway_s', (2.0, 1.0)),
    ('lane_shares', (1.0,)), ('change_s', (0.1, 2.0))])
def test_invalid_vehicles_are_refused(field, value):
    with pytest.raises(InputError, match=field):
        TrafficConfig(**{field: value})
