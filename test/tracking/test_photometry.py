# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Observations as normal equations: in a known linear world, and by hand."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.tracker_config import NoiseConfig, VisibilityConfig
from stereo_speed.tracking.motion_prior import rates_by_offsets
from stereo_speed.tracking.observation import Observation
from stereo_speed.tracking.observation_kernels import normalised_change, without
from stereo_speed.tracking.photometric_terms import temporal
from stereo_speed.tracking.photometry import (
    PassPhotometry, Photometry, scatters_px, views_agree)
from stereo_speed.tracking.relief import relief_basis
from stereo_speed.vision.haar import PartGrid

BASIS = relief_basis(PartGrid(10, 8).unit_xy)
NODES = BASIS.shape[1]
FLAT = np.zeros(NODES)


def photometry(limits=VisibilityConfig(), **noise):
    return PassPhotometry(BASIS, NoiseConfig(**noise), limits)


def linear_observations(rng, count, relief, texture_noise=0.0, lag_s=0.0, gone=None):
    """
    Return observations of one texture that change linearly with small poses and the relief.

    :param lag_s: by which the right views are later, if any.
    :param gone: (count, 3) how much further on these show the front.
    """
    samples, texture = len(BASIS), rng.normal(size=len(BASIS))
    texture -= texture.mean()
    gradient = rng.normal(size=(2, samples))
    observations, poses = [], 1e-5 * rng.normal(size=(count, 3))
    gone = np.zeros((count, 3)) if gone is None else gone(poses)
    for pose, further in zip(poses, gone):
        flow = rng.normal(size=(2, 2, 3, samples))
        raw = np.einsum('vipg,ig->vpg', flow, gradient)
        for part in (np.ones(samples), texture):  # invisible in a patch of unit variance
            share = part * (raw @ part / (part @ part))[..., None]  # (2, 3, G)
            flow -= (gradient / np.square(gradient).sum(axis=0))[:, None] * share[:, None]
        raw = np.einsum('vipg,ig->vpg', flow, gradient)
        change = normalised_change(raw, np.stack([texture, texture]))
        values = texture - np.stack([pose @ change[0], (pose + further) @ change[1]]) \
            - raw[:, 0] * (BASIS @ relief)
        values = values + texture_noise * rng.normal(size=values.shape)
        observations.append(Observation(
            pose=np.zeros(3), heading_rad=0.0, relief=FLAT, patches=values, jacobian=change,
            relief_jacobian=raw[:, 0], outlines=np.zeros((2, samples)),
            glare=np.zeros((2, samples)),
            by_blur=np.zeros((2, samples)),
            apart_jacobian=change[0] - change[1], apart_relief=raw[0, 0] - raw[1, 0],
            pixels=float(samples),
            shift_px=np.ones((2, 3)), disparity_px=np.ones(3), velocity_mps=np.zeros(3),
            lag_s=lag_s, skew_px=0.0))
    return observations, poses


def test_equations_find_poses_and_relief_of_a_linear_world():
    rng = np.random.default_rng(4)
    relief = 1e-5 * rng.normal(size=NODES)
    observations, poses = linear_observations(rng, 5, relief)
    seen = photometry()(observations)
    solution = np.linalg.lstsq(seen.H, seen.right, rcond=1e-6)[0]
    found, depth = solution[:15].reshape(5, 3), solution[15:]
    np.testing.assert_allclose(found[:, 1:], poses[:, 1:], atol=1e-8)
    # Relief that protrudes evenly is a front further on.  The gains of the patches are
    # unknown, too, and absorb a few hundredths of the change.
    few = 0.03 * relief.std()
    np.testing.assert_allclose(depth - depth.mean(), relief - relief.mean(), atol=few)
    np.testing.assert_allclose(
        found[:, 0] + depth.mean(), poses[:, 0] + relief.mean(), atol=few)


def like_blur(rng, observations, lengths):
    """
    Return observations whose pose changes them much as blur does, and which are blurred.

    :param observations: with their true poses.
    :param lengths: (n, 2) change of each view by blur.
    """
    texture = np.mean([o.patches for o, _ in observations], axis=(0, 1))
    change = normalised_change(rng.normal(size=(1, len(texture))), texture)[0]
    moves = [o.jacobian + 10.0 * np.array([0.3, 1.0, -0.5])[:, None] * change
             for o, _ in observations]
    return [replace(
        o, by_blur=np.tile(change, (2, 1)), jacobian=J,
        patches=o.patches - np.einsum('c,vcg->vg', pose, J - o.jacobian)
        + length[:, None] * change)
        for (o, pose), J, length in zip(observations, moves, lengths)]


def in_glare(observations, poses, rng, growth):
    """
    Return observations half of whose samples lie in glare, which changes by itself.

    :param growth: by how much it changes from one observation to the next, of what a pose does.
    """
    inside = np.arange(len(BASIS)) % 2
    size = 1e-5 * growth * np.arange(len(poses))
    return [replace(o, glare=np.tile(inside * 1.0, (2, 1)),
                    patches=o.patches - k * inside * o.jacobian[:, 1]
                    + 1e-9 * rng.normal(size=o.patches.shape))
            for o, k in zip(observations, size)]


@pytest.mark.parametrize('apart', [False, True])
def test_glare_that_grows_by_itself_does_not_displace_a_front(apart):
    rng = np.random.default_rng(4)
    observations, poses = linear_observations(rng, 5, FLAT, lag_s=0.5 if apart else 0.0)
    seen = in_glare(observations, poses, rng, 0.3)
    off = []
    for floor_px in (0.0, 1.0):
        found = photometry(glare_floor_px=floor_px, tail_dof=1e6, texture_floor_px=1e-6)(
            seen, rates_per_s=np.zeros((5, 5)) if apart else None)
        poses_found = np.linalg.lstsq(found.H, found.right, rcond=1e-7)[0][:15].reshape(5, 3)
        error = poses_found[:, 1] - poses[:, 1]
        off.append(np.ptp(error - error.mean()))
    assert off[1] < 0.2 * off[0]


def test_clipped_pixels_raise_the_floor_of_the_texture():
    """By hand: in two of four observations to 0.1 px, so the mean square is that of 0.0721 px."""
    rng = np.random.default_rng(5)
    whole, _ = linear_observations(rng, 4, FLAT, 0.02)
    outline = rng.normal(size=(2, len(BASIS)))
    outline /= np.linalg.norm(outline, axis=1, keepdims=True)
    clipped = [*whole[:2], *(replace(o, outlines=outline, jacobian=without(o.jacobian, outline))
                             for o in whole[2:])]

    def information(observations, **floors):
        return photometry(match_floor_px=1.0, **floors)(observations).H
    np.testing.assert_allclose(
        information(clipped, texture_floor_px=0.02, clipped_floor_px=0.1),
        information(clipped, texture_floor_px=0.0721, clipped_floor_px=0.0), rtol=1e-3)
    for observations, floor_px in ((whole, 0.1), (clipped, 0.01)):
        np.testing.assert_array_equal(
            information(observations, texture_floor_px=0.02, clipped_floor_px=floor_px),
            information(observations, texture_floor_px=0.02, clipped_floor_px=0.0))


def test_information_in_glare_is_limited_by_its_own_floor():
    """By hand: parts in and out of glare are each limited by their floor, then they add."""
    rng = np.random.default_rng(4)
    observations, _ = linear_observations(rng, 2, FLAT, 0.02)
    half = np.tile(np.arange(len(BASIS)) % 2 * 1.0, (2, 1))

    def blocks(glare, floor_px, glare_floor_px):
        patches, jacobian, by_relief, outlines = (
            np.stack([getattr(o, name) for o in observations])
            for name in ('patches', 'jacobian', 'relief_jacobian', 'outlines'))
        samples = len(BASIS)
        return temporal(np.arange(2), patches, jacobian, by_relief, outlines,
                        np.stack([glare] * 2), np.zeros(samples), np.zeros((2, samples)),
                        np.full(2, float(samples)), np.ones(2), 3.0, 0.3, floor_px,
                        glare_floor_px).blocks[:, 1, 1]
    free_out, free_in = (blocks(half, *floors) for floors in ((0.0, 1e6), (1e6, 0.0)))
    np.testing.assert_allclose(blocks(half, 0.0, 0.0), free_out + free_in, rtol=1e-6)
    np.testing.assert_allclose(
        blocks(half, 0.02, 0.5), free_out / (1 + 0.02**2 * free_out)
        + free_in / (1 + 0.5**2 * free_in), rtol=1e-6)
    np.testing.assert_array_equal(blocks(0 * half, 0.02, 0.5), blocks(0 * half, 0.02, 9.0))


@pytest.mark.parametrize('apart', [False, True])
def test_unknown_blur_is_no_evidence_of_the_pose(apart):
    """The true poses are found, however much each observation is blurred."""
    rng = np.random.default_rng(4)
    observations, poses = linear_observations(rng, 5, FLAT, lag_s=0.5 if apart else 0.0)
    blurred = like_blur(rng, list(zip(observations, poses)), 1e-3 * rng.normal(size=(5, 1))
                        * np.ones(2))
    seen = photometry()(blurred, rates_per_s=np.zeros((5, 5)) if apart else None)
    found = np.linalg.lstsq(seen.H, seen.right, rcond=1e-7)[0][:15].reshape(5, 3)
    np.testing.assert_allclose(found[:, 1:], poses[:, 1:], atol=0.03e-5)


def test_blur_of_one_view_alone_is_not_taken_for_blur_of_both():
    """What differs between the views of one exposure remains evidence."""
    rng = np.random.default_rng(4)
    observations, poses = linear_observations(rng, 5, FLAT)
    lengths = 1e-3 * rng.normal(size=(5, 1))
    both, opposite = (photometry()(like_blur(
        np.random.default_rng(5), list(zip(observations, poses)), lengths * sides))
        for sides in (np.array([1.0, 1.0]), np.array([1.0, -1.0])))
    assert np.linalg.norm(opposite.right) > 3 * np.linalg.norm(both.right)


def test_equations_find_the_speeds_of_views_exposed_apart():
    """Along the path, across it by slopes of parabolas, and off the epipolar line."""
    rng, lag_s = np.random.default_rng(4), 0.5
    speeds, lines_px = 1e-5 * rng.normal(size=(2, 5))
    rates_per_s = rates_by_offsets(np.array([0.0, 0.2, 0.4, 0.5, 0.8]))
    observations, poses = linear_observations(
        rng, 5, FLAT, lag_s=lag_s, gone=lambda poses: np.column_stack(
            [lag_s * speeds, lag_s * rates_per_s @ poses[:, 1], -lines_px]))
    seen = photometry()(observations, rates_per_s=rates_per_s)
    assert seen.lines == 5 and len(seen.right) == 4 * 5 + NODES + 5
    solution = np.linalg.lstsq(seen.H, seen.right, rcond=1e-7)[0]
    found = solution[:15].reshape(5, 3)
    few = 0.03e-5
    np.testing.assert_allclose(found[:, 1:], poses[:, 1:], atol=few)
    np.testing.assert_allclose(solution[15:20], speeds, atol=few / lag_s)
    np.testing.assert_allclose(solution[-5:], lines_px, atol=few)


def test_views_of_one_exposure_have_no_information_on_speeds():
    """As in the equations without speeds, except that two views are better than their mean."""
    observations, _ = linear_observations(np.random.default_rng(4), 5, FLAT, 0.02)
    alone, apart = photometry()(observations), photometry()(observations, rates_per_s=np.eye(5))
    assert not apart.H[15:20].any() and not apart.right[15:20].any()
    poses = slice(0, 15)
    np.testing.assert_allclose(np.diag(apart.H)[poses], np.diag(alone.H)[poses], rtol=0.2)


def test_eliminated_scatter_equals_an_explicit_unknown():
    """Against the same equations with these unknowns included, for any poses and relief."""
    observations, _ = linear_observations(np.random.default_rng(4), 5, FLAT, 0.1)
    per_px, std_px = np.linspace(0.5, 3.0, 5), 0.07
    placed = [replace(o, pose=np.array([0.1 * k, 0.2, 0.0]), disparity_px=np.full(3, px))
              for k, (o, px) in enumerate(zip(observations, per_px))]
    seen = photometry()(placed)
    size = len(seen.H)
    whole = np.zeros((size + 5, size + 5))
    whole[:size, :size], whole[size:, :size] = seen.H, seen.along
    whole[:size, size:] = seen.along.T
    # An error of the disparity moves the position in proportion.
    whole[size:, size:] = np.diag(seen.own_m + per_px ** 2 / std_px ** 2)
    right = np.concatenate([seen.right, seen.along_right])
    said = seen.scattered(std_px)
    np.testing.assert_allclose(np.linalg.inv(said.H + np.eye(size)), np.linalg.inv(
        whole + np.diag(np.r_[np.ones(size), np.zeros(5)]))[:size, :size], rtol=1e-6, atol=1e-12)
    for x in np.random.default_rng(5).normal(0, 0.1, (3, size)):
        rest = right[size:] - whole[size:, :size] @ x
        free = 0.5 * rest @ np.linalg.solve(whole[size:, size:], rest) - 0.5 * np.linalg.slogdet(
            whole[size:, size:])[1] + 0.5 * np.log(per_px ** 2 / std_px ** 2).sum()
        plain = right[:size] @ x - 0.5 * x @ seen.H @ x
        density = said.log_density + said.right @ x - 0.5 * x @ said.H @ x
        assert density == pytest.approx(plain + free, rel=1e-9, abs=1e-6)


def test_zero_additional_scatter_changes_nothing():
    observations, _ = linear_observations(np.random.default_rng(4), 3, FLAT, 0.1)
    seen = photometry()(observations)
    assert seen.scattered(0.0).H is seen.H and seen.scattered(0.0).log_density == 0


def test_scatters_double_and_differ_from_the_median_by_a_factor():
    """By hand: 0.1, 0.2 and 0.4 px, of which the last two lie 1 and 2 factors above the first."""
    known = scatters_px(NoiseConfig(match_floor_px=0.1, scatter_px=0.1, scatter_factor=2.0,
                                    scatter_levels=3))
    wanted = np.exp([0.0, -0.5, -2.0])
    np.testing.assert_allclose([more for more, _ in known], 0.1 * np.sqrt([0, 3, 15]))
    np.testing.assert_allclose([share for _, share in known], wanted / wanted.sum())
    assert scatters_px(NoiseConfig(match_floor_px=0.0)) == [(0.0, 1.0)]


def test_scatter_of_drawn_and_of_real_passes_is_not_excluded_beforehand():
    """Painted fronts scatter by the floor, path-traced ones by 0.02 to 0.1 px."""
    shares = dict(scatters_px(NoiseConfig()))
    assert all(share > 0.04 for more_px, share in shares.items() if more_px < 0.1)


def test_misplaced_observation_is_no_outlier():
    """If large differences were down-weighted, a wrong position would persist."""
    observations, _ = linear_observations(np.random.default_rng(4), 4, FLAT, 0.02)
    moved = [*observations[:3], replace(observations[3], patches=observations[3].patches
                                        + 0.05 * observations[3].jacobian[:, 0])]
    information = [photometry(match_floor_px=1.0, texture_floor_px=0.0)(some).H[9, 9]
                   for some in (observations, moved)]
    assert information[1] > 0.3 * information[0]


def test_equations_do_not_depend_on_the_point_of_linearisation():
    """The relief at which they were linearised makes no difference."""
    rng = np.random.default_rng(4)
    relief = rng.normal(0, 0.05, NODES)
    observations, _ = linear_observations(rng, 4, relief, 0.1)
    assumed = rng.normal(0, 0.05, NODES)
    moved = [replace(o, relief=assumed, patches=o.patches + o.relief_jacobian * (BASIS @ assumed))
             for o in observations]
    answers = []
    for one in (observations, moved):
        seen = photometry(tail_dof=1e6)(one)
        known = np.r_[np.full(12, 1e-9), np.full(NODES, NoiseConfig().relief_std_m ** -2)]
        answers.append(np.linalg.solve(seen.H + np.diag(known), seen.right))
    # Weights follow the residuals, which differ; the answer nearly does not.
    np.testing.assert_allclose(answers[0], answers[1], atol=0.02)


def test_highlight_sliding_over_the_front_does_not_bias_the_poses():
    """A tenth of each patch shows something else each time; the poses are found nevertheless."""
    rng = np.random.default_rng(11)
    errors = []
    for changed in (0, 64):
        observations, poses = linear_observations(np.random.default_rng(12), 6, FLAT, 0.02)
        slid = []
        for k, one in enumerate(observations):
            patches = one.patches.copy()
            patches[:, 40 * k:40 * k + changed] += rng.normal(2.0, 0.3, (2, changed))
            slid.append(replace(one, patches=patches))
        answers = []
        for dof in (2.0, 1e6):
            seen = photometry(tail_dof=dof)(slid)
            found = np.linalg.lstsq(seen.H, seen.right, rcond=1e-6)[0][:18].reshape(6, 3)
            answers.append(np.sqrt(np.mean(np.square(found - poses)[:, 1:])))
        errors.append(answers)
    (clear, _), (weighed, counted_alike) = errors
    assert weighed < 1.5 * clear < 0.3 * counted_alike


def test_uncounted_observations_do_not_affect_the_others():
    rng = np.random.default_rng(7)
    observations, _ = linear_observations(rng, 4, FLAT, 0.1)
    noise = rng.normal(size=observations[1].patches.shape)
    observations[1] = replace(observations[1], patches=observations[1].patches + noise)
    kept = [0, 2, 3]
    alone = photometry()([observations[k] for k in kept])
    seen = photometry()(observations, np.array([True, False, True, True]))
    at = np.r_[np.add.outer([0, 6, 9], np.arange(3)).ravel(), np.arange(12, len(seen.right))]
    np.testing.assert_allclose(seen.H[np.ix_(at, at)], alone.H, atol=1e-6 * np.abs(alone.H).max())
    np.testing.assert_allclose(seen.right[at], alone.right, atol=1e-6 * np.abs(alone.right).max())
    assert not seen.H[3:6].any() and not seen.right[3:6].any()
    np.testing.assert_allclose(seen.cross_ncc[kept], alone.cross_ncc)


def test_same_observations_give_the_same_equations():
    rng = np.random.default_rng(8)
    observations, _ = linear_observations(rng, 3, FLAT, 0.1)
    written = photometry()
    first = written(observations)
    written(observations[:1])
    again = written(observations)
    np.testing.assert_array_equal(again.H, first.H)
    np.testing.assert_array_equal(again.right, first.right)


def test_information_grows_with_the_share_of_independent_samples():
    """Without floors it is proportional to the share."""
    observations, _ = linear_observations(np.random.default_rng(9), 3, FLAT, 0.1)
    some, twice = (photometry(independent_share=share, match_floor_px=0.0, texture_floor_px=0.0)(
        observations).H for share in (0.2, 0.4))
    np.testing.assert_allclose(twice, 2 * some, atol=1e-9 * np.abs(some).max())


@pytest.mark.parametrize('floor, other, row, share', [
    ('match_floor_px', 'texture_floor_px', 0, 1.0),
    ('texture_floor_px', 'match_floor_px', 1, 0.75)])
def test_information_of_one_observation_is_limited_by_its_floor(floor, other, row, share):
    """
    The 1-sigma of one observation is the floor, however many samples it has.

    ``disparity_px`` and ``shift_px`` are 1 px/m here, so that a pixel is a metre.  The texture is
    the mean of four patches with independent derivatives, and gets a quarter of their information.
    """
    observations, _ = linear_observations(np.random.default_rng(10), 2, FLAT, 0.01)
    information = []
    for std in (0.02, 0.0):
        only = {floor: std, other: 1.0}  # the other term has almost no information
        information.append(photometry(independent_share=1.0, **only)(observations).H[row, row])
    assert information[1] > 1e5  # as the noise allows
    assert 0.02 ** 2 * information[0] == pytest.approx(share, rel=0.05)


def seen_with(cross, texture, **limits):
    none = np.zeros(0)
    return Photometry(none, none, none, none, none, none, np.array(cross), np.array(texture),
                      VisibilityConfig(**limits))


@pytest.mark.parametrize('cross, unoccluded', [
    ((0.99, 0.98, 0.93, 0.92, 0.4), (1, 1, 1, 0, 0)),
    ((0.9, 0.9, 0.9, 0.68, 0.6), (1, 1, 1, 1, 0))])
def test_partly_occluded_observations_differ_from_noisy_ones(cross, unoccluded):
    """The limit is 0.03 plus three times the best: 0.03 + 3 * 0.014 or 0.03 + 3 * 0.1."""
    wanted = np.array(unoccluded, bool)
    np.testing.assert_array_equal(seen_with(cross, (0.99,) * 5).unoccluded, wanted)
    # The texture's lack is judged in the same way while the views lack a little, too.
    little = np.where(np.arange(5) < 3, 0.99, 0.95)
    np.testing.assert_array_equal(seen_with(little, cross).unoccluded, wanted)


@pytest.mark.parametrize('cross, agree', [(0.96, True), (0.95, False), (0.4, False)])
def test_views_of_another_pair_agree_within_the_limit_of_the_best(cross, agree):
    """They lack at most three times the 0.014 of the best."""
    assert views_agree(cross, np.array([0.99, 0.98, 0.95, 0.95, 0.4]), VisibilityConfig()) == agree
    assert not views_agree(0.49, np.full(5, 0.5), VisibilityConfig())  # another object


def test_changing_light_is_no_occlusion():
    """The views still agree, so no post is in front of the front."""
    views, texture = (0.99, 0.98, 0.99, 0.98, 0.99), (0.99, 0.99, 0.9, 0.7, 0.6)
    assert seen_with(views, texture).unoccluded.all()


@pytest.mark.parametrize('limits, unoccluded', [
    ({'occlusion_deficit': 0.2}, (1, 1, 1)),
    ({'occlusion_noise_factor': 0.0}, (1, 0, 0)),
    ({'occlusion_best_share': 1.0}, (1, 1, 1)),
    ({'occlusion_deficit': 0.2, 'least_ncc': 0.9}, (1, 1, 0))])
def test_each_limit_of_occlusion_counts(limits, unoccluded):
    """Lacks of 0.01, 0.09 and 0.2; by default 0.03 + 3 * 0.026 is allowed."""
    found = seen_with((0.99, 0.91, 0.8), (1.0, 1.0, 1.0), **limits)
    np.testing.assert_array_equal(found.unoccluded, np.array(unoccluded, bool))
    np.testing.assert_array_equal(seen_with((0.99, 0.91, 0.8), (1.0,) * 3).unoccluded,
                                  [True, True, False])


def test_observation_with_too_little_agreement_is_not_seen():
    found = seen_with((0.9, 0.49, 0.9), (0.9, 0.9, 0.49))
    np.testing.assert_array_equal(found.seen, [True, False, False])
