# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The verdict on a pass, and the end of a track, independent of the images."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.core.passes import Reason, TrackEnd, Verdict
from stereo_speed.core.records import TrackState
from stereo_speed.core.tracker_config import VerdictConfig, VisibilityConfig
from stereo_speed.lab.baselines.baseline import Baseline, Estimate
from stereo_speed.lab.baselines.settings import MotionSettings
from stereo_speed.lab.baselines.speed_profile import Profile


class Scripted(Baseline[MotionSettings]):
    """A baseline that knows the truth, and sees the vehicle in given pairs."""

    Settings = MotionSettings
    seen_in = frozenset(range(100))
    std_mps = 0.01

    def __init__(self, world, **script):
        super().__init__(world.start, world.placed, MotionSettings())
        self.world, self.ns = world, 0
        vars(self).update(script)

    def _predict(self, dt_s):
        self.ns += round(dt_s * 1e9)

    def _observe(self, pair):
        return pair.index in self.seen_in

    def _estimate(self):
        world, centre = self.world, self.world.centre_m(self.ns)
        corners = centre + world.corners_m @ world.axes[:, 1:].T
        return Estimate(centre, 0.01 * np.eye(3), world.speed_mps * world.axes[:, 0],
                        self.std_mps ** 2 * np.eye(3), world.axes,
                        world.rig.project(corners)[:2])

    def _profile(self):
        n = len(self.life.stamps_ns)
        return Profile(np.full(n, self.world.speed_mps), np.full(n, self.std_mps), self.std_mps)


def test_good_pass_is_measured(scene):
    world = scene(focal_std=0.003, baseline_std_m=0.002)
    one = Scripted(world)
    updates = world.run(one, 6)
    result = one.result()
    assert (result.verdict, result.reason, result.end) == (
        Verdict.MEASURED, '', TrackEnd.STREAM_ENDED)
    share = np.hypot(0.003, 0.002 / 0.5)  # by hand: focal length, and baseline of half a metre
    assert result.speed_std_mps == pytest.approx(np.hypot(0.01, 20 * share))
    assert updates[-1].speed_std_mps == pytest.approx(result.speed_std_mps)
    assert list(result.smoothed) == [u.stamp_ns for u in updates]
    assert (result.first_ns, result.last_ns, result.pairs) == (0, 1_000_000_000, 6)


def test_speed_and_its_sigma_along_the_motion():
    estimate = Estimate(np.zeros(3), np.eye(3), np.array([3.0, 0, 4]),
                        np.diag([0.25, 100.0, 0.04]), np.eye(3), (np.zeros((4, 2)),) * 2)
    assert estimate.speed_mps == pytest.approx(5.0)
    assert estimate.speed_std_mps == pytest.approx(np.sqrt(0.36 * 0.25 + 0.64 * 0.04))


@pytest.mark.parametrize(('reason', 'script', 'changes'), [
    (Reason.NEVER_SEEN, {'seen_in': ()}, {}),
    (Reason.TOO_FEW_PAIRS, {'seen_in': (0,)}, {}),
    (Reason.TOO_FEW_PAIRS, {}, {'verdict': VerdictConfig(least_pairs=7)}),
    (Reason.NEVER_SEEN, {'seen_in': (0, 1)}, {}),
    (Reason.TOO_FAR, {}, {'verdict': VerdictConfig(least_width_px=500.0)}),
    (Reason.IMPLAUSIBLE, {}, {'verdict': VerdictConfig(most_speed_mps=15.0)}),
    (Reason.UNCERTAIN, {'std_mps': 1.0}, {}),
    (Reason.TOO_FAR, {'std_mps': 1.0}, {'verdict': VerdictConfig(far_width_px=500.0)})],
    ids=lambda value: str(value) if isinstance(value, Reason) else None)
def test_reasons_of_rejected_passes(scene, reason, script, changes):
    world = scene(**changes)
    one = Scripted(world, **script)
    world.run(one, 6)
    result = one.result()
    assert (result.verdict, result.reason) == (Verdict.REJECTED, reason)
    assert (result.speed_mps is None) == (len(script.get('seen_in', '12')) < 2)


def test_vehicle_that_is_not_seen_again_is_lost(scene):
    world = scene(visibility=VisibilityConfig(lost_after_s=0.5))
    one = Scripted(world, seen_in=(0, 1, 2))
    states = [u.state if u else None for u in world.run(one, 8)]
    assert states[2:] == [TrackState.CONFIRMED, TrackState.COASTING, TrackState.COASTING,
                          None, None, None]
    assert one.ended and one.result().end is TrackEnd.LOST


def test_vehicle_leaves_the_view(scene):
    world = scene()
    one = Scripted(world)
    updates = world.run(one, 20)
    last = [u for u in updates if u][-1]
    assert one.ended and one.result().end is TrackEnd.LEFT_VIEW and updates[-1] is None
    assert world.rig.left.holds(last.quad_left_px)
