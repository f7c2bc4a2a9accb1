# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Every baseline through the protocol, on simulated passes with exact truth."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from stereo_speed.core.passes import Verdict
from stereo_speed.core.records import TrackState
from stereo_speed.core.tracker_config import TrackerConfig, VisibilityConfig
from stereo_speed.lab.sim.config import SimConfig, VehicleConfig
from stereo_speed.pipeline.registry import TRACKERS
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
from stereo_speed.site.lane_paths import lane_paths
from stereo_speed.tracking.protocol import TrackStart
import yaml

pytestmark = pytest.mark.slow  # whole drives; the other files test the parts
FRONT_HEIGHT_M = VehicleConfig().front_height_m
BASELINES = [name for name in TRACKERS.own if name != 'constrained']
FALSE_ALARM = 1e-3  # of each test, were all errors Gaussian with the reported covariance


def blank(pair):
    grey = np.full_like(pair.left, 100)
    return replace(pair, left=grey, right=grey)


def errors(updates, sequence):
    speeds = np.array([float(row['speed']) for row in sequence.truth])
    return np.array([u.speed_mps for u in updates]) - speeds[:len(updates)]


def most_sigmas(count):
    """Return a bound on the greatest of some errors, whether or not they are correlated."""
    return norm.isf(FALSE_ALARM / (2 * count))


@pytest.mark.parametrize('name', BASELINES)
def test_pass_with_distorted_lenses_and_uneven_stamps(name, straight, drive):
    updates, result = drive(straight, name)
    assert len(updates) == len(straight.pairs)
    assert [u.state for u in updates[:2]] == [TrackState.TENTATIVE] * 2
    assert {u.state for u in updates[2:]} == {TrackState.CONFIRMED}
    assert list(result.smoothed) == [u.stamp_ns for u in updates] == list(result.smoothed_std)
    for update, row in list(zip(updates, straight.truth))[-3:]:
        off = update.position_m - np.array([float(row[k]) for k in 'xyz'])
        along = update.axes[:, 0]
        assert abs(off @ along) < most_sigmas(3) * np.sqrt(along @ update.position_cov_m2 @ along)
        assert np.linalg.norm(off - off @ along * along) < FRONT_HEIGHT_M / 2  # on the vehicle
        assert abs(update.lateral_m - float(row['lateral'])) < FRONT_HEIGHT_M / 2
        assert np.isfinite(update.quad_left_px).all() and np.isfinite(update.quad_right_px).all()
        np.testing.assert_allclose(update.axes.T @ update.axes, np.eye(3), atol=1e-9)
        assert np.linalg.det(update.axes) == pytest.approx(1)


@pytest.mark.parametrize('name', BASELINES)
def test_sigma_covers_the_truth_and_beats_manual_annotation(name, straight, drive):
    updates, result = drive(straight, name)
    off = errors(updates, straight)[2:] / [u.speed_std_mps for u in updates[2:]]
    assert np.abs(off).max() < most_sigmas(len(off))
    speed = float(straight.truth[0]['speed'])
    assert abs(result.speed_mps - speed) < most_sigmas(1) * result.speed_std_mps
    assert result.speed_std_mps < by_hand_mps(straight)


def by_hand_mps(sequence):
    """Return the 1-sigma of a speed from the first and the last front, annotated manually."""
    rig, config = sequence.rig, SimConfig()
    depths = np.array([float(sequence.truth[k]['z']) for k in (0, -1)])
    corners = 4
    disparity_std_px = config.init_std_px * np.sqrt(2 / corners)
    std_m = depths ** 2 / (rig.left.K[0, 0] * rig.baseline_m) * disparity_std_px
    stamps = [sequence.pairs[k].stamp_ns for k in (0, -1)]
    return np.hypot(*std_m) / ((stamps[1] - stamps[0]) * 1e-9)


@pytest.mark.parametrize('name', ['kalman', 'flow', 'multimodal'])
def test_bend(name, circle, drive):
    updates, result = drive(circle, name)
    speed = float(circle.truth[0]['speed'])
    assert result.verdict is Verdict.MEASURED and result.pairs == len(circle.pairs)
    assert abs(result.speed_mps - speed) < most_sigmas(1) * result.speed_std_mps
    late = errors(updates, circle)[2:] / [u.speed_std_mps for u in updates[2:]]
    assert np.abs(late).max() < most_sigmas(len(late))


@pytest.mark.parametrize('name', BASELINES)
def test_same_seed_repeats_the_readings(name, straight, drive):
    again = drive(straight, name, straight.pairs[:4])[0]
    first = drive(straight, name)[0][:4]
    assert [u.speed_mps for u in again] == [u.speed_mps for u in first]


@pytest.mark.parametrize('name', ['flow', 'multimodal', 'unconstrained'])
def test_vehicle_is_reacquired_after_pairs_that_do_not_show_it(name, straight, drive):
    pairs = [blank(p) if p.index == 5 else p for p in straight.pairs]
    updates, result = drive(straight, name, pairs)
    assert [k for k, u in enumerate(updates) if u.state is TrackState.COASTING] == [5]
    assert result.pairs == len(pairs) - 1 and len(result.smoothed) == result.pairs
    speed = float(straight.truth[0]['speed'])
    assert abs(result.speed_mps - speed) < most_sigmas(1) * result.speed_std_mps


@pytest.mark.parametrize(('name', 'reason'), [
    ('flow', 'too_few_features'), ('multimodal', 'never_seen'), ('unconstrained', 'never_seen')])
def test_vehicle_lost_for_good_ends_its_track(name, reason, straight, drive):
    soon = VisibilityConfig(lost_after_s=0.5)
    pairs = [blank(p) if p.index > 1 else p for p in straight.pairs]
    updates, result = drive(straight, name, pairs, visibility=soon)
    assert len(updates) < len(pairs) and (result.pairs, result.end) == (2, 'lost')
    assert (result.verdict, result.reason) == (Verdict.REJECTED, reason)


def test_late_right_view_counts_at_its_own_time(straight, tmp_path):
    """Fed directly, for a pipeline would correct stamps that contradict the images."""
    (tmp_path / 'site.yaml').write_text(yaml.safe_dump(dict(straight.site_exact)))
    (tmp_path / 'init.yaml').write_text(yaml.safe_dump(dict(straight.init)))
    lane = next(iter(lane_paths(load_site(tmp_path / 'site.yaml'), straight.rig).values()))
    front, = load_init(tmp_path / 'init.yaml')
    kind, places = TRACKERS.load('multimodal'), []
    for delay_ns in (0, 20_000_000):
        # Changed stamps displace the front by the distance travelled in 20 ms.
        pairs = [replace(p, right_stamp_ns=p.right_stamp_ns + delay_ns) for p in straight.pairs]
        tracker = kind.start(TrackStart(
            rig=straight.rig, lane=lane, config=TrackerConfig(), front=front, pair=pairs[0],
            track=0, rng=np.random.default_rng(0)), kind.Settings())
        places.append([tracker.update(pair) for pair in pairs][-1].position_m)
    assert 0.2 < np.linalg.norm(places[1] - places[0]) < 8.0
