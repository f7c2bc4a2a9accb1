# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Sequences with truth: simulated with and without tolerances, and a tracker's run."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.records import StereoPair
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.labeled_sequence import (
    bag_sequence, disturbed, LineKnowledge, read_back, run_tracker, simulated_sequence)
from stereo_speed.lab.evaluation.metrics import pass_error, readings
from stereo_speed.lab.evaluation.scorer import SequenceRun
from stereo_speed.lab.sim.config import RigConfig, RoadConfig, straight_config
from stereo_speed.lab.sim.scene import make_rig
from stereo_speed.lab.sim.sequence import SimSequence
from stereo_speed.road.problem import RoadPrior
from stereo_speed.site.file import load_site

SMALL = RigConfig(width_px=512, height_px=384, f_px=900.0)
CONFIG = straight_config('55 mph', rig=SMALL, pairs=6, start_m=36.0, road=RoadConfig(lanes=1))


@pytest.fixture(scope='module')
def sequence():
    return simulated_sequence(CONFIG, (0,), LineKnowledge.EXACT)


def test_run_equals_replay_and_is_repeatable(sequence):
    one, again = (run_tracker(sequence, 'constrained', TrackerConfig(), 4) for _ in range(2))
    assert replace(one, cpu_ms=0) == replace(again, cpu_ms=0)
    run, = one.vehicles
    speed, truth = readings(run)
    assert run.verdict == 'measured'
    assert np.allclose(truth, 55 * MPH_MPS, atol=1e-4)
    assert np.abs(speed - truth).max() < 0.5
    assert abs(pass_error(run)) < 4 * run.pass_std_mps
    assert SequenceRun.from_json(one.to_json()) == one


@pytest.mark.slow
def test_refined_lines_give_a_better_road(sequence):
    moved = replace(CONFIG, pairs=3, rig_moved_deg=(0.02, 0.0, 0.0))
    refined = simulated_sequence(moved, (0,), LineKnowledge.REFINED).site
    assert np.degrees(refined.rig.drift_rad[0]) == pytest.approx(0.02, abs=0.004)
    truth = sequence.site.lanes['lane_0'].path.frame(np.array(10.0))[:, 0]  # of the exact lines
    path = refined.lanes['lane_0'].path
    ahead = path.frame(np.array(path.length_m / 2))[:, 0]
    assert np.degrees(np.arccos(min(float(ahead @ truth), 1.0))) < 0.05


def test_disturbances_are_as_large_as_the_tolerances():
    tolerances, rig, image = TrackerConfig(), make_rig(CONFIG.rig), np.zeros((2, 2), np.uint8)
    pairs = tuple(StereoPair(k, k * 10 ** 9, k * 10 ** 9 + 7, image, image) for k in range(5))
    rows = tuple({'stamp_ns': k * 10 ** 9, 'vehicle': 0} for k in range(5))
    plain = SimSequence(CONFIG, None, rig, {}, {}, {}, pairs, rows)
    drawn = [disturbed(plain, tolerances, np.random.default_rng(k)) for k in range(300)]
    focal = np.array([s.rig.left.K[0, 0] / rig.left.K[0, 0] - 1 for s in drawn])
    base = np.array([s.rig.baseline_m - rig.baseline_m for s in drawn])
    late = np.array([[p.stamp_ns - q.stamp_ns for p, q in zip(s.pairs, pairs)] for s in drawn])
    for values, std in ((focal, tolerances.focal_std), (base, tolerances.baseline_std_m),
                        (late.ravel() * 1e-9, tolerances.stamp_std_s)):
        bound = 4 / np.sqrt(2 * len(values))  # of a standard deviation's share, 4 sigma
        assert abs(values.std() / std - 1) < bound
        assert abs(values.mean()) < 4 * std / np.sqrt(len(values))
    s = drawn[0]
    assert np.array_equal(s.rig.left.K[:2, 2], rig.left.K[:2, 2])
    assert [r['stamp_ns'] for r in s.truth] == [p.stamp_ns for p in s.pairs]
    assert {p.right_stamp_ns - p.stamp_ns for p in s.pairs} == {7}


def test_disturbed_cameras_that_converge_still_agree_at_infinity():
    """An error of 0.05 % would displace views that converge by 3 degrees by five tolerances."""
    config = replace(
        SMALL, left_rotation_deg=(0.0, 1.5, 0.0), right_rotation_deg=(0.0, -1.5, 0.0))
    rig = make_rig(config)
    plain = SimSequence(replace(CONFIG, rig=config), None, rig, {}, {}, {}, (), ())
    uv_px = np.array([[180.0, 100.0], [256.0, 192.0], [300.0, 250.0]])
    off_px = np.array([
        drawn.right.project(drawn.left.rays(uv_px) @ drawn.R.T)[0][:, 0]
        for drawn in (rig, *(disturbed(plain, TrackerConfig(), np.random.default_rng(k)).rig
                             for k in range(200)))])
    angle_px = config.f_px * np.radians(RoadPrior().calibrated_std_deg)
    assert 0.8 * angle_px < (off_px[1:] - off_px[0]).std() < 1.2 * angle_px


def test_site_passes_through_a_file_as_in_practice(sequence):
    assert sequence.site.site.where.endswith('.yaml')
    with pytest.raises(InputError, match='content.yaml: stereo_speed_site: found 7'):
        read_back({'stereo_speed_site': 7}, load_site)


def test_bag_brings_its_site_annotations_and_truth(sample):
    bag = bag_sequence(sample / 'bag', sample / 'site.yaml', sample / 'init.yaml',
                       sample / 'truth.csv')
    truth, = bag.truths
    assert truth.at([pair.stamp_ns for pair in bag.pairs]).tolist() == list(range(len(bag.pairs)))
    assert len(bag.annotations) == 1 and bag.site.refined is None
    found = bag_sequence(sample / 'bag', sample / 'site.yaml', None, sample / 'truth.csv')
    assert found.annotations is None
