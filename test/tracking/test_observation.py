# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Observations of a front whose images have a closed form: patches, derivatives, geometry."""
from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from stereo_speed.core.tracker_config import NoiseConfig
from stereo_speed.tracking.front import Front
from stereo_speed.tracking.observation import _glare, ObservationSampler
from stereo_speed.tracking.observation_kernels import normalised_change
from stereo_speed.vision.haar import PartGrid

GRID = PartGrid(10, 8)
POSE = np.array([20.0, 0.1, 1.9])  # 40 m away
STILL = np.zeros(3)


def sampler_of(textured, noise=NoiseConfig()):
    front = Front(textured.path, textured.corners_m)
    return ObservationSampler(textured.rig, front, GRID.unit_xy, GRID.shape, noise)


@pytest.fixture(scope='module')
def clear(textured):
    """Return the front without noise."""
    return replace(textured, noise=0.0)


@pytest.fixture(scope='module')
def pair(clear):
    return clear.pair(0, 0, POSE)


def observe(sampler, pair, pose=POSE, velocity_mps=STILL, heading_rad=0.0, relief=None):
    relief = np.zeros(sampler.relief_basis.shape[1]) if relief is None else relief
    return sampler.observe(pair, pose, velocity_mps, heading_rad, relief)


def test_patches_are_the_texture_of_the_front(clear, pair):
    seen = observe(sampler_of(clear), pair)
    x, y = (0.94 * (GRID.unit_xy - 0.5) * [1.8, -0.8]).T
    texture = clear.texture(x, y)
    np.testing.assert_allclose(seen.patches.mean(axis=1), 0.0, atol=1e-9)
    np.testing.assert_allclose(seen.patches.std(axis=1), 1.0)
    for patch in seen.patches:  # except for the low-pass
        assert np.corrcoef(patch, texture)[0, 1] > 0.97


def test_patches_are_valid_only_on_the_front(clear, pair):
    sampler = sampler_of(clear)
    agree = [float(np.mean(np.prod(observe(sampler, pair, POSE + [ds, 0, 0]).patches, axis=0)))
             for ds in (0.0, -1.5, 1.5)]
    # 1.5 m of depth shift the views by f b / Z^2 * 1.5 = 0.7 px.
    assert agree[0] > 0.995 and agree[0] - max(agree[1:]) > 0.01


@pytest.mark.parametrize('axis, step_m', [(0, 0.2), (1, 0.005), (2, 0.005)])
def test_derivatives_are_those_of_the_patches(clear, pair, axis, step_m):
    sampler = sampler_of(clear)
    ahead, behind = (observe(sampler, pair, POSE + sign * step_m * np.eye(3)[axis]).patches
                     for sign in (1, -1))
    want = (ahead - behind) / (2 * step_m)
    got = observe(sampler, pair).jacobian[:, axis]
    # Gradients of pixels are smoother than the splines' own: short waves lose up to a third.
    assert np.linalg.norm(got - want) < 0.35 * np.linalg.norm(want)
    assert np.sum(got * want) > 0.95 * np.linalg.norm(got) * np.linalg.norm(want)


def test_relief_has_the_same_effect_as_moving_forward(clear, pair):
    """A front with constant relief equals a front further on."""
    sampler = sampler_of(clear)
    relief = np.full(sampler.relief_basis.shape[1], 0.5)
    out, on = observe(sampler, pair, relief=relief), observe(sampler, pair, POSE + [0.5, 0, 0])
    # Its outline is then seen nearer: 0.5 m in 40 m.
    np.testing.assert_allclose(out.patches, on.patches, atol=0.15)


def test_geometry_by_hand(clear, pair):
    """At 40 m 1 m is 37.5 px wide, and the disparity of 18.75 px grows as f b / Z^2."""
    seen = observe(sampler_of(clear), pair)
    np.testing.assert_allclose(seen.shift_px[:, 1:], 37.5, rtol=1e-3)
    np.testing.assert_allclose(seen.disparity_px, [1500 * 0.5 / 40 ** 2, 0, 0], atol=1e-3)
    # The centre (0.1, 0.1) m from the axis moves outwards, in the right view inwards.
    outwards = 1500 * np.hypot([0.1, -0.4], 0.1) / 40 ** 2
    np.testing.assert_allclose(seen.shift_px[:, 0], outwards, rtol=1e-3)
    assert seen.pixels == min(1.8 * 0.8 * 37.5 ** 2, len(GRID.unit_xy))
    assert seen.right_m == 0.0 and seen.skew_px == 0.0


def test_pixel_count_shrinks_with_distance(clear):
    far = np.array([-20.0, 0.0, 1.9])  # 80 m away
    seen = observe(sampler_of(clear), clear.pair(0, 0, far), far)
    assert seen.pixels == pytest.approx(1.8 * 0.8 * (1500 / 80) ** 2, rel=1e-3)


@pytest.mark.parametrize('grey', [0, 1600, 65535])
def test_views_that_show_nothing_do_not_agree(clear, pair, grey):
    """Samples of an even image differ by rounding, which is the same in both views."""
    sampler, blank = sampler_of(clear), np.full_like(pair.left, grey)
    nothing = replace(pair, left=blank, right=blank)
    for ds in np.linspace(0.0, 1.0, 40):
        assert abs(observe(sampler, nothing, POSE + [ds, 0, 0]).cross_ncc) < 0.01


@pytest.mark.parametrize('pose', [(20.0, 3.5, 1.9), (20.0, -3.3, 1.9), (20.0, 0.1, -1.5)])
def test_front_not_wholly_in_both_images_is_not_observed(clear, pair, pose):
    assert observe(sampler_of(clear), pair, np.array(pose)) is None


def test_later_right_view_is_sampled_where_the_front_was_then(clear):
    velocity, lag_ns = np.array([20.0, 0.5, 0.0]), 40_000_000
    late = clear.pair(0, 0, POSE, right_ns=lag_ns, right_pose=POSE + 0.04 * velocity)
    seen = observe(sampler_of(clear), late, velocity_mps=velocity)
    unaware = observe(sampler_of(clear), late.triggered(0.1), velocity_mps=velocity)
    agree = [float(np.mean(np.prod(o.patches, axis=0))) for o in (seen, unaware)]
    assert agree[0] > 0.995 and agree[1] < agree[0]
    assert seen.right_m == pytest.approx(0.8) and seen.skew_px == 0.0
    # Without the lag the error in the right view is at most the motion during it.
    moved = clear.rig.project(np.array([[0.1, 0.1, 40.0], [0.12, 0.1, 39.2]]))[1]
    assert unaware.right_m == 0.0
    assert unaware.skew_px == pytest.approx(np.linalg.norm(np.diff(moved, axis=0)), rel=0.05)


@pytest.mark.parametrize('axis, step_mps', [(0, 5.0), (1, 0.1)])
def test_speed_derivative_of_a_later_right_view_equals_differences(clear, axis, step_mps):
    """Against differences: lag times derivative by the pose; the left view is unaffected."""
    sampler, velocity, lag_s = sampler_of(clear), np.array([20.0, 0.5, 0.0]), 0.04
    late = clear.pair(0, 0, POSE, right_ns=round(lag_s * 1e9),
                      right_pose=POSE + lag_s * velocity)
    step = step_mps * np.eye(3)[axis]
    less, seen, more = (observe(sampler, late, velocity_mps=velocity + way)
                        for way in (-step, 0 * step, step))
    np.testing.assert_array_equal(less.patches[0], more.patches[0])
    slope = (more.patches[1] - less.patches[1]) / (2 * step_mps)
    wanted = seen.lag_s * seen.jacobian[1, axis]
    # As gradients of pixels are, see above; a wrong sign or lag is off by more.
    assert np.linalg.norm(wanted - slope) < 0.35 * np.linalg.norm(slope)
    assert slope @ wanted > 0.95 * np.linalg.norm(slope) * np.linalg.norm(wanted)


def test_heading_is_observed_as_a_rotated_plane(clear):
    rotated = clear.pair(0, 0, POSE, heading_rad=0.3)
    sampler = sampler_of(clear)
    x, y = (0.94 * (GRID.unit_xy - 0.5) * [1.8, -0.8]).T
    likeness = [np.corrcoef(observe(sampler, rotated, heading_rad=psi).patches[0],
                            clear.texture(x, y))[0, 1] for psi in (0.0, 0.3)]
    assert likeness[1] > 0.97 > likeness[0]


def test_normalised_change_is_orthogonal_to_constant_and_patch():
    rng = np.random.default_rng(0)
    patch = rng.normal(size=50)
    patch = (patch - patch.mean()) / patch.std()
    step, raw = 1e-6, rng.normal(size=(3, 50))
    got = normalised_change(raw, patch)
    for axis in range(3):
        values = patch + step * raw[axis]
        np.testing.assert_allclose(
            got[axis], ((values - values.mean()) / values.std() - patch) / step, atol=1e-4)


def with_lamp(clear, radius_px, spread=0.0, spread_px=16.0):
    """
    Return the pair in 8 bits, with a clipped lamp before the front's centre.

    :param spread: share of its light that spreads in the lens, by a Gaussian of ``spread_px``.
    """
    pair, centres = clear.pair(0, 0, POSE), [q.mean(axis=0) for q in clear.quads(POSE)]
    views = []
    for image, (u, v) in zip((pair.left, pair.right), centres):
        at_u, at_v = np.meshgrid(np.arange(320) - u, np.arange(240) - v)
        lamp = cv2.GaussianBlur(
            2000.0 * np.clip(radius_px + 0.5 - np.hypot(at_u, at_v), 0, 1), (0, 0), 1.0)
        lamp += spread * cv2.GaussianBlur(lamp, (0, 0), spread_px)
        views.append(np.clip(image / 16.0 + lamp, 0, 255).astype(np.uint8))
    return replace(pair, left=views[0], right=views[1])


def test_outline_is_the_change_caused_by_a_spreading_clipped_lamp(clear):
    sampler = sampler_of(clear)
    small, large = (observe(sampler, with_lamp(clear, radius)) for radius in (3.0, 3.5))
    assert not observe(sampler, clear.pair(0, 0, POSE)).outlines.any()  # nothing is clipped
    for view in (0, 1):
        outline = small.outlines[view]
        change = normalised_change(
            (large.patches[view] - small.patches[view])[None], small.patches[view])[0]
        assert np.linalg.norm(outline) == pytest.approx(1.0)
        assert abs(outline @ small.patches[view]) < 1e-6 and abs(outline.sum()) < 1e-6
        np.testing.assert_allclose(small.jacobian[view] @ outline, 0.0, atol=1e-6)
        rest = change - (change @ outline) * outline
        assert np.linalg.norm(rest) < 0.7 * np.linalg.norm(change)


def test_glare_is_what_is_bright_around_a_lamp_on_all_sides(clear):
    """Not what surrounds a lamp that is sharp."""
    sampler, pose = sampler_of(clear), POSE
    assert not observe(sampler, clear.pair(0, 0, pose)).glare.any()
    assert not observe(sampler, with_lamp(clear, 3.0)).glare.any()
    glare = observe(sampler, with_lamp(clear, 3.0, 6.0)).glare
    assert glare.max() > 0.8
    rows, columns = sampler.grid_shape
    middle = glare[0].reshape(rows, columns)[rows // 2]
    assert middle[columns // 2] == pytest.approx(glare[0].max())
    wider = observe(sampler, with_lamp(clear, 5.0, 6.0)).glare
    assert wider.sum() > glare.sum()
    none = sampler_of(clear, NoiseConfig(glare_level=10.0))
    assert not observe(none, with_lamp(clear, 3.0, 6.0)).glare.any()


@pytest.mark.parametrize('gamma', [1.0, 2.2])
def test_lamp_that_clips_in_one_view_is_blurred_as_in_the_other(clear, gamma):
    """The view in focus then looks like the one whose light, or whose grey levels, are blurred."""
    pair = with_lamp(clear, 3.0)
    pair = replace(pair, right=clear.softened(pair, 2.0, gamma).right)
    assert pair.left.max() == 255 > pair.right.max()
    sampler = sampler_of(clear)
    sampler.blur_px = 2.0, 0.0
    lacks = []
    for sampler.blur_gamma in (gamma, 3.2 - gamma):
        lacks.append(1 - observe(sampler, pair).cross_ncc)
    assert lacks[0] < 1e-3 and lacks[0] < 0.1 * lacks[1]


@pytest.mark.parametrize(('around', 'wanted'), [
    (0.2, 0.0), (0.34, 0.0), (0.45, 0.5), (0.5, 0.75), (0.9, 1.0)])
def test_share_of_glare_by_hand(around, wanted):
    """A square lamp of 11 px is 6 px deep: its glare reaches 3 + 2 times that beyond it."""
    crop = np.full((61, 61), around * 255, np.float32)
    crop[:, 50:] = 0.0  # something dark far from it
    crop[25:36, 25:36] = 255
    glare = _glare(crop, (crop == 255).astype(np.uint8), 255, NoiseConfig())
    if not wanted:
        assert glare is None
        return
    assert set(np.unique(glare)) == {np.float32(0.0), glare.max()}
    assert glare.max() == pytest.approx(wanted, abs=0.01)
    columns = np.flatnonzero(glare[30])
    reach = 25 - columns[0]
    assert 11 <= reach <= 15 and columns[-1] - 35 == reach


def test_a_lamp_with_something_dark_on_one_side_has_no_glare():
    """Light that spreads in the lens is on all sides; so three quarters must be bright."""
    crop = np.full((61, 61), 230, np.float32)
    crop[25:36, 25:36] = 255
    clipped = (crop == 255).astype(np.uint8)
    assert _glare(crop, clipped, 255, NoiseConfig()) is not None
    crop[:, :28] = np.where(clipped[:, :28], 255, 40)
    assert _glare(crop, clipped, 255, NoiseConfig()) is None


def test_spots_have_no_glare():
    """Of sun on pale paint."""
    crop = np.full((40, 40), 200, np.float32)
    crop[10:12, 10:14] = crop[30, 30] = 255
    assert _glare(crop, (crop == 255).astype(np.uint8), 255, NoiseConfig()) is None


@pytest.mark.parametrize('bits', [10, 12, 16])
def test_lamps_clip_where_the_bits_of_the_camera_end(clear, bits):
    """Cameras of 10 and 12 bits write them into 16."""
    pair, most = with_lamp(clear, 3.0), (1 << bits) - 1
    deep = replace(pair, **{side: np.rint(getattr(pair, side) * (most / 255)).astype(np.uint16)
                            for side in ('left', 'right')})
    found, wanted = (observe(sampler_of(clear), one) for one in (deep, pair))
    assert wanted.outlines.any()
    np.testing.assert_allclose(found.outlines, wanted.outlines, atol=0.01)


@pytest.mark.parametrize('gamma', [1.0, 2.2])
@pytest.mark.parametrize('sigma_px', [0.3, 0.5])
def test_change_by_blur_is_that_of_a_little_gaussian_blur(clear, sigma_px, gamma):
    """Up to the edges of the front, in grey values and per square of the grid's steps."""
    sampler = sampler_of(clear, NoiseConfig(gamma=gamma))
    pair = clear.with_contrast(clear.pair(0, 0, POSE))
    blurred = clear.softened(pair, sigma_px, gamma)
    sharp, soft = observe(sampler, pair), observe(sampler, blurred)
    for view in (0, 1):
        change = normalised_change(
            (soft.patches[view] - sharp.patches[view])[None], sharp.patches[view])[0]
        wanted = sharp.by_blur[view]
        assert change @ wanted > 0.97 * np.linalg.norm(change) * np.linalg.norm(wanted)


@pytest.mark.parametrize('lit', [False, True])
def test_part_is_normalised_like_a_front_of_its_own(clear, pair, lit):
    """Removing gain and level twice changes nothing, so the whole as a part is the whole."""
    seen = observe(sampler_of(clear), with_lamp(clear, 4.0) if lit else pair)
    whole = seen.part(np.ones(640, dtype=bool))
    for field in ('patches', 'jacobian', 'relief_jacobian', 'outlines', 'by_blur',
                  'apart_jacobian', 'apart_relief', 'pixels'):
        np.testing.assert_allclose(getattr(whole, field), getattr(seen, field), atol=1e-3)
    assert seen.outlines.any() == lit
    which = np.arange(640) % 40 >= 10
    part = seen.part(which)
    assert part.pixels == pytest.approx(0.75 * seen.pixels)
    np.testing.assert_array_equal(part.patches, seen.patches[:, which])
    np.testing.assert_array_equal(part.relief_jacobian, seen.relief_jacobian[:, which])
    along = [np.ones_like(part.patches), part.patches, part.outlines]
    for other in along:
        np.testing.assert_allclose(np.einsum('vcg,vg->vc', part.jacobian, other), 0, atol=1e-6)
    assert np.linalg.norm(part.outlines, axis=1) == pytest.approx([float(lit)] * 2)


def test_part_without_contrast_is_finite(clear):
    seen = observe(sampler_of(clear), with_lamp(clear, 4.0))
    grey = np.arange(640) < 320
    part = replace(seen, patches=np.where(grey, 0.5, seen.patches)).part(grey)
    for values in (part.jacobian, part.outlines, part.by_blur, part.apart_jacobian):
        assert np.isfinite(values).all() and np.abs(values).max() < 1e3
