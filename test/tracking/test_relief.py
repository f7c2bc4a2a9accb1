# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The relief of a front: its functions, its place in the equations, and what it is worth."""
from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from stereo_speed.lab.sim import simulate, straight_config, VehicleConfig
from stereo_speed.pipeline.assembly import make_pipeline
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.pipeline.run import run
from stereo_speed.road.path import StraightPath
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
from stereo_speed.site.lane_paths import lane_paths
from stereo_speed.tracking.front import plane_points
from stereo_speed.tracking.observation import normalised_change
from stereo_speed.tracking.photometry import PassPhotometry, Photometry
from stereo_speed.tracking.relief import NODES, relief_basis, STD_M as RELIEF_STD_M
from stereo_speed.vision.haar import PartGrid
import yaml


def test_basis_interpolates_its_nodes_and_sums_to_one():
    across, down = np.meshgrid(np.linspace(0, 1, NODES[0]), np.linspace(0, 1, NODES[1]))
    at_nodes = relief_basis(np.column_stack([across.ravel(), down.ravel()]))
    np.testing.assert_allclose(at_nodes, np.eye(NODES[0] * NODES[1]), atol=1e-12)
    anywhere = relief_basis(np.random.default_rng(0).uniform(0, 1, (50, 2)))
    np.testing.assert_allclose(anywhere.sum(axis=1), 1.0)


def test_relief_stands_out_forward_also_when_the_vehicle_turns():
    path = StraightPath(np.array([0.0, 2, 60]), np.array([0.0, 0, -1]), 50.0)  # left is +x
    got = plane_points(path, np.array([[10.0, 0, 0]]), np.zeros((1, 2)), np.pi / 6,
                       np.array([0.2]))
    np.testing.assert_allclose(got[0, 0], [0.1, 2.0, 50 - 0.2 * np.sqrt(0.75)], atol=1e-12)


def fake_looks(rng, count, basis, relief, texture_noise=0.0):
    """Make looks at one texture that change linearly with small poses and the relief."""
    samples, texture = len(basis), rng.normal(size=len(basis))
    texture -= texture.mean()
    gradient = rng.normal(size=(2, samples))
    looks, poses = [], 1e-5 * rng.normal(size=(count, 3))
    for pose in poses:
        flow = rng.normal(size=(2, 2, 3, samples))
        raw = np.einsum('vipg,ig->vpg', flow, gradient)
        for part in (np.ones(samples), texture):  # what a patch of unit variance cannot show
            share = part * (raw @ part / (part @ part))[..., None]  # (2, 3, G)
            flow -= (gradient / np.square(gradient).sum(axis=0))[:, None] * share[:, None]
        raw = np.einsum('vipg,ig->vpg', flow, gradient)
        change = normalised_change(raw, np.stack([texture, texture]))
        values = texture - pose @ change - raw[:, 0] * (basis @ relief)
        values = values + texture_noise * rng.normal(size=values.shape)
        looks.append(SimpleNamespace(
            pose=np.zeros(3), relief=np.zeros(basis.shape[1]), patches=values, jacobian=change,
            relief_jacobian=raw[:, 0], pixels=float(samples),
            shift_px=np.ones((2, 3)), disparity_px=np.ones(3), skew_px=0.0, right_m=0.0))
    return looks, poses


def test_equations_find_poses_and_relief_of_a_linear_world():
    rng = np.random.default_rng(4)
    basis = relief_basis(PartGrid(10, 8).unit_xy)
    relief = 1e-5 * rng.normal(size=basis.shape[1])
    looks, poses = fake_looks(rng, 5, basis, relief)
    seen = PassPhotometry(basis)(looks)
    solution = np.linalg.lstsq(seen.H, seen.right, rcond=1e-6)[0]
    found, depth = solution[:15].reshape(5, 3), solution[15:]
    np.testing.assert_allclose(found[:, 1:], poses[:, 1:], atol=1e-8)
    # Relief that stands out everywhere alike is a front further on.
    np.testing.assert_allclose(depth - depth.mean(), relief - relief.mean(), atol=1e-8)
    np.testing.assert_allclose(found[:, 0] + depth.mean(), poses[:, 0] + relief.mean(), atol=1e-8)


def test_equations_do_not_depend_on_the_relief_they_were_linearised_at():
    rng = np.random.default_rng(4)
    basis = relief_basis(PartGrid(10, 8).unit_xy)
    relief = rng.normal(0, 0.05, basis.shape[1])
    looks, _ = fake_looks(rng, 4, basis, relief, 0.1)
    taken = rng.normal(0, 0.05, basis.shape[1])
    moved = [SimpleNamespace(**{**vars(look), 'relief': taken, 'patches': look.patches
                                + look.relief_jacobian * (basis @ taken)}) for look in looks]
    answers = []
    for one in (looks, moved):
        seen = PassPhotometry(basis)(one)
        known = np.r_[np.full(12, 1e-9), np.full(len(relief), RELIEF_STD_M ** -2)]
        answers.append(np.linalg.solve(seen.H + np.diag(known), seen.right))
    # Weights follow the residuals, which differ; the answer nearly does not.
    np.testing.assert_allclose(answers[0], answers[1], atol=0.02)


def test_looks_that_do_not_count_say_nothing_to_the_others():
    rng = np.random.default_rng(7)
    basis = relief_basis(PartGrid(10, 8).unit_xy)
    looks, _ = fake_looks(rng, 4, basis, np.zeros(basis.shape[1]), 0.1)
    looks[1].patches = looks[1].patches + rng.normal(size=looks[1].patches.shape)
    kept = [0, 2, 3]
    alone = PassPhotometry(basis)([looks[k] for k in kept])
    seen = PassPhotometry(basis)(looks, np.array([True, False, True, True]))
    at = np.r_[np.add.outer([0, 6, 9], np.arange(3)).ravel(), np.arange(12, len(seen.right))]
    np.testing.assert_allclose(seen.H[np.ix_(at, at)], alone.H, atol=1e-6 * np.abs(alone.H).max())
    np.testing.assert_allclose(seen.right[at], alone.right, atol=1e-6 * np.abs(alone.right).max())
    assert not seen.H[3:6].any() and not seen.right[3:6].any()
    np.testing.assert_allclose(seen.cross_ncc[kept], alone.cross_ncc)


def test_looks_hidden_in_part_are_told_from_noisy_ones():
    """A lack of 0.03, and three times that of the best: 0.03 + 3 * 0.014 or 0.03 + 3 * 0.1."""
    texture = np.full(5, 0.99)
    for cross, clear in (((0.99, 0.98, 0.93, 0.92, 0.4), (1, 1, 1, 0, 0)),
                         ((0.9, 0.9, 0.9, 0.68, 0.6), (1, 1, 1, 1, 0))):
        seen = Photometry(np.zeros(0), np.zeros(0), np.array(cross), texture)
        np.testing.assert_array_equal(seen.clear(), np.array(clear, bool))
        swapped = Photometry(np.zeros(0), np.zeros(0), texture, np.array(cross))
        np.testing.assert_array_equal(swapped.clear(), np.array(clear, bool))


def test_a_front_with_relief_is_measured_as_well_as_a_flat_one(tmp_path):
    config = replace(straight_config('55 mph'), vehicles=(VehicleConfig(relief_m=0.05),))
    errors = []
    for seed in range(2):
        sequence = simulate(config, np.random.default_rng(seed))
        (tmp_path / 's.yaml').write_text(yaml.safe_dump(dict(sequence.site_exact)))
        (tmp_path / 'i.yaml').write_text(yaml.safe_dump(dict(sequence.init)))
        pipeline = make_pipeline(
            sequence.rig, lane_paths(load_site(tmp_path / 's.yaml'), sequence.rig),
            PipelineConfig(), load_init(tmp_path / 'i.yaml'))
        result, = run(pipeline, sequence.pairs).passes
        errors.append(result.speed_mps - float(sequence.truth[0]['speed']))
    # On a plane the same passes are 0.1 m/s off.
    assert np.sqrt(np.mean(np.square(errors))) < 0.03, errors
