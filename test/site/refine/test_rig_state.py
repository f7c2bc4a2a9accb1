# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A rig that has moved since its site was refined is detected in its images."""
from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from stereo_speed.core.records import RigMotion
from stereo_speed.enforcement.instrument import Instrument
from stereo_speed.lab.sim.config import straight_config
from stereo_speed.lab.sim.sequence import simulate
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.pipeline.config import PipelineConfig, SiteConfig
from stereo_speed.pipeline.rig_look import look_at_rig
from stereo_speed.road.fitted import RoadFit
from stereo_speed.road.model import RoadModel
from stereo_speed.road.path import StraightPath
from stereo_speed.road.problem import Picks, RoadProblem
from stereo_speed.site.file import PickedLine
from stereo_speed.site.lane_paths import lane_paths
from stereo_speed.site.refine import rig_state as module
from stereo_speed.site.refine.rig_state import moved_together, rig_state, Stance
from stereo_speed.site.refine.speed_effect import Setup, speed_error

SMALL = {'width_px': 512, 'height_px': 384, 'f_px': 900.0}


@pytest.fixture(scope='module')
def measured_with(make_scene):
    """Return the configuration of a scene, its measuring setup, and its pairs."""
    config = straight_config(pairs=5, rig=replace(straight_config().rig, **SMALL))
    scene = make_scene(config, 4)
    rig = scene.sequence.rig
    used = Stance(scene.site, rig, lane_paths(scene.site, rig))
    return config, used, scene.sequence.pairs


@pytest.mark.slow
def test_fixed_rig_is_not_off(measured_with):
    _, used, pairs = measured_with
    state = rig_state(used, pairs)
    assert state.share is not None and not state.is_off, state
    assert not state.turned and not state.confirmed


@pytest.fixture(scope='module')
def turned(measured_with):
    """Return the configuration of a rig whose right camera pans, its pairs, and their state."""
    config, used, _ = measured_with
    config = replace(config, rig_moved_deg=(0.05, 0.0, 0.0))
    pairs = simulate(config, np.random.default_rng(5)).pairs
    return config, pairs, rig_state(used, pairs)


@pytest.mark.slow
@pytest.mark.parametrize('pole_deg', [1.0, 3.0])
def test_turned_pole_is_off_and_known(measured_with, pole_deg):
    """Its lines are 16 to 47 px away from where they were; the cameras stand as calibrated."""
    config, used, _ = measured_with
    config = replace(config, camera_yaw_deg=pole_deg)
    moved = simulate(config, np.random.default_rng(5))
    state = rig_state(used, moved.pairs)
    assert state.is_off and not state.turned and state.stance is not None
    scene = moved.scene
    lines_m = list(scene.road.line_offsets().values())  # from right to left
    for name, right_m, left_m in zip(('lane_0', 'lane_1'), lines_m, lines_m[1:]):
        path = state.stance.lanes[name].path
        true_m = scene.to_left(scene.road.position(
            np.linspace(-60, 120, 9001), np.full(9001, (right_m + left_m) / 2)))
        found_m = path.position(np.linspace(0.2, 0.8, 7) * path.length_m)
        assert cKDTree(true_m).query(found_m)[0].max() < 0.05


def test_lines_must_have_moved_together(drawn):
    """By one rotation of the rig, not one line alone as if another thing was found beside it."""
    x_m, z_m = {'right': -2.0, 'left': 1.5, 'far': 5.0}, np.linspace(15, 40, 15)
    turn = Rotation.from_euler('yx', [2.0, -0.5], degrees=True).as_matrix()

    def at(name, x_m, rotation=np.eye(3)):
        points = np.stack([np.full(15, x_m), np.full(15, 3.0), z_m], axis=-1)
        return PickedLine(name, *drawn.rig.project(points @ rotation.T))
    still, turned = ({name: at(name, x, r) for name, x in x_m.items()} for r in (np.eye(3), turn))
    old = drawn.fit.problem.model
    model = RoadModel(old.frame, old.centre_m, old.half_length_m, len(x_m))
    picks = Picks.of({name: line.views_px for name, line in still.items()})
    x = np.array([0, 0, 0, 0, *x_m.values()])
    road = RoadFit(RoadProblem(drawn.rig, picks, model), x, 0.0)
    assert moved_together(road, still)
    assert moved_together(road, turned)
    assert not moved_together(road, {**still, 'right': turned['right']})
    assert not moved_together(road, {**still, 'left': at('left', 2.3)})
    assert not moved_together(road, {**turned, 'far': still['far']})


@pytest.mark.slow
def test_swaying_rig_is_not_off(measured_with):
    config, used, _ = measured_with
    pairs = simulate(replace(config, sway_deg=0.1), np.random.default_rng(5)).pairs
    state = look_at_rig(used, pairs, SiteConfig())
    assert state.share is not None and not state.is_off, state.text


@pytest.mark.slow
def test_rotation_followed_by_steadying_is_not_off(measured_with, turned):
    _, used, _ = measured_with
    config, pairs, state = turned
    followed = RigMotion((0.0, 0.0, 0.0), tuple(np.radians(config.rig_moved_deg)))
    assert state.is_off
    assert not rig_state(used, pairs, followed=followed).is_off


@pytest.mark.slow
def test_two_looks_that_agree_determine_the_new_state(measured_with, turned):
    _, used, standing = measured_with
    config, _, first = turned
    assert first.is_off and first.turned and not first.confirmed
    second = rig_state(used, simulate(config, np.random.default_rng(6)).pairs,
                       suspected=first.stance)
    assert second.confirmed
    # speeds with the found pose are right; those with the site's are wrong by tenths
    seen_by = used.rig.drifted(np.radians(config.rig_moved_deg))
    true = {name: Setup(lane.path, seen_by) for name, lane in used.lanes.items()}
    for stance, most in ((second.stance, 0.01), (used, None)):
        errors = [abs(speed_error(true[name], Setup(stance.lanes[name].path, stance.rig)))
                  for name in used.lanes]
        assert max(errors) < most if most else min(errors) > 0.05
    # and the pose can be restored from its record
    stance = second.stance
    measured = MeasuringSite(stance.site, stance.rig, stance.lanes, corrected=True)
    told = Instrument.of('run', measured, PipelineConfig()).text()
    again = Instrument.of_text(told, 'instrument').place('instrument')
    assert again.rig.R == pytest.approx(stance.rig.R, abs=1e-9)
    for name, lane in stance.lanes.items():
        s_m = np.linspace(0, lane.path.length_m, 20)
        assert again.lanes[name].path.position(s_m) == pytest.approx(
            lane.path.position(s_m), abs=2e-3)
    # the rig was corrected in between: the checks do not agree
    third = rig_state(used, standing, suspected=first.stance)
    assert not third.is_off and not third.confirmed


@pytest.mark.slow
def test_invisible_road_gives_no_evidence(measured_with):
    _, used, pairs = measured_with
    dark = [replace(p, left=np.zeros_like(p.left), right=np.zeros_like(p.right)) for p in pairs]
    state = rig_state(used, dark)
    assert state.share is None and not state.is_off and state.text


def test_lane_out_of_view_is_named_beside_an_unmoved_one(measured_with, monkeypatch):
    _, used, pairs = measured_with
    name, lane = next(iter(used.lanes.items()))
    behind = replace(lane, path=StraightPath(
        np.array([0.0, 2.0, -60.0]), np.array([0.0, 0.0, 1.0]), 40.0, np.array([0.0, -1.0, 0.0])))
    lanes = {name: lane, 'behind': behind}
    monkeypatch.setattr(module, 'refine_site', lambda *_: SimpleNamespace(
        kept_clicks='', found=[name], lanes=lanes, rig=used.rig, site=used.site,
        drift=SimpleNamespace(moved=False)))
    state = rig_state(replace(used, lanes=lanes), pairs)
    assert state.lane == name and state.share == pytest.approx(0.0, abs=1e-6)
    assert state.text.endswith('out of view: behind') and state.stance is None
