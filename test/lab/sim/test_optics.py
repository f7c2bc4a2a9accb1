# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Lenses, clipping and camera faults; reflections of wet roads and glossy paint."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from stereo_speed.lab.sim import RigConfig, SimConfig, simulate, straight_config, VehicleConfig
from stereo_speed.lab.sim.optics import FaultConfig, LensConfig, Optics
from stereo_speed.lab.sim.painter import Painter
from stereo_speed.lab.sim.planes import Eye, Plane, Texture
from stereo_speed.lab.sim.props import WET_NIGHT
from stereo_speed.lab.sim.scene import SimScene
from stereo_speed.lab.sim.surface import Sky, Surface
from stereo_speed.lab.sim.view import rig_views
from stereo_speed.lab.sim.wet import streak

LENS = LensConfig(core_px=0.7, halo_share=0.04, halo_px=8.0)
TINY = RigConfig(width_px=96, height_px=72, f_px=168.0)
SIZE = (256, 192)


def _optics(lens=LensConfig(), faults=FaultConfig(), size=SIZE):
    return Optics(lens, faults, size, np.random.default_rng(0))


def _clipped_columns(image):
    """Return the width of the clipped region, px, including the shares of its edges."""
    # Above the background, in logarithms: point spreads fall off steeply.
    row = np.log(np.maximum(image[image.max(axis=1).argmax()] - 40, 1e-3) / (255 - 40))
    k = np.flatnonzero(row >= 0)
    low, high = k[0], k[-1]
    return (high - low + row[high] / (row[high] - row[high + 1])
            + row[low] / (row[low] - row[low - 1]))


@pytest.mark.parametrize('light', [2e4, 2e5, 2e6])
def test_point_light_clips_as_wide_as_the_point_spread_predicts(light):
    image = np.full(SIZE[::-1], 40.0, np.float32)
    image[96, 128] += light
    seen = _optics(LENS).spread(image, 0)
    assert float(seen.sum()) == pytest.approx(float(image.sum()), rel=1e-3)

    def gap(r_px):
        return 40 + sum(share * light / (2 * np.pi * s * s) * np.exp(-(r_px / s) ** 2 / 2)
                        for share, s in ((1 - LENS.halo_share, LENS.core_px),
                                         (LENS.halo_share, LENS.halo_px))) - 255
    assert _clipped_columns(seen) == pytest.approx(2 * brentq(gap, 0, 100), abs=0.5)


def test_clipping_widens_a_lamp_by_a_constant_number_of_pixels():
    """The number does not depend on its range."""
    eye = Eye(rig_views(SimScene(straight_config()).rig)[0])
    wide_m, grown, ratio = 0.3, [], []
    for z in (80.0, 40.0, 20.0):
        image = np.full((768, 1024), 40.0, np.float32)
        across, down = np.array([wide_m, 0, 0]), np.array([0, 0.12, 0])
        eye.draw(image, Plane(np.array([-wide_m / 2, 0.0, z]), across, down,
                              Texture.of(np.ones((12, 30), np.float32)), True, emits=8000.0))
        found = _clipped_columns(_optics(LensConfig(core_px=0.7), size=(1024, 768))
                                 .spread(image, 0))
        grown.append(found - wide_m * 1800 / z)
        ratio.append(found / (wide_m * 1800 / z))
    assert min(grown) > 1.0 and np.ptp(grown) < 0.4
    assert ratio[0] > ratio[1] > ratio[2]


def test_cameras_that_encode_light_see_edges_move_into_the_dark():
    """By hand: where half of the light of white arrives, 186 is written instead of 128."""
    image = np.zeros(SIZE[::-1], np.float32)
    image[:, 128:] = 255.0
    columns = []
    for gamma, middle in ((1.0, 127.5), (2.2, 186.1)):
        seen = _optics(LensConfig(core_px=2.0, gamma=gamma)).spread(image, 0)[96]
        assert seen[127:129].mean() == pytest.approx(middle, abs=2.0)
        columns.append(np.interp(127.5, seen, np.arange(SIZE[0])))
    # half of white is 0.22 of the light, 0.78 sigma into the dark
    assert columns[0] - columns[1] == pytest.approx(2.0 * 0.78, abs=0.05)


def test_faults_affect_one_camera_and_persist():
    rng = np.random.default_rng(1)
    one, other = (rng.uniform(20, 200, SIZE[::-1]).astype(np.float32) for _ in range(2))
    dirty = _optics(faults=FaultConfig(dirt=6, dirt_depth=0.5, dirt_px=20.0))
    np.testing.assert_array_equal(dirty.spread(one, 0), one)
    clear = dirty.spread(one, 1) / one
    np.testing.assert_allclose(dirty.spread(other, 1) / other, clear, rtol=1e-5)
    assert clear.min() < 0.85 and np.median(clear) > 0.9 and clear.max() <= 1
    soft = _optics(faults=FaultConfig(right_defocus_px=2.0))
    np.testing.assert_array_equal(soft.spread(one, 0), one)
    # A Gaussian of 2 px leaves 1 / (16 pi) of the variance of white noise.
    assert soft.spread(one, 1).var() == pytest.approx(one.var() / (16 * np.pi), rel=0.15)


def test_exposure_step_scales_both_views_of_a_pair_and_no_truth():
    config = SimConfig(rig=TINY, pairs=8, fps=5.0, noise_grey=0.0, exposure=0.6)
    stepped = replace(config, faults=FaultConfig(exposure_step=0.15))
    base, found = (simulate(c, np.random.default_rng(0)) for c in (config, stepped))
    assert base.truth == found.truth and base.site == found.site and base.init == found.init
    gains = []
    for a, b in zip(base.pairs, found.pairs):
        sides = [float(y.astype(float).sum() / x.astype(float).sum())
                 for x, y in ((a.left, b.left), (a.right, b.right))]
        assert sides[0] == pytest.approx(sides[1], abs=0.01)
        gains.append(sides[0])
    assert 0.84 < min(gains) < 0.95 and 1.05 < max(gains) < 1.16


def test_lamp_reflection_is_where_its_mirror_image_projects():
    scene = SimScene(straight_config())
    foot = scene.point(35.0, 0.0)
    lamp, mirrored = foot + 0.7 * scene.up, foot - 0.7 * scene.up
    for view in rig_views(scene.rig):
        eye, image = Eye(view), np.zeros((768, 1024), np.float32)
        streak(image, eye, lamp, mirrored, 20000.0, 0.05, 1.0)
        (u, v), = eye.project(mirrored[None])
        row, column = np.unravel_index(image.argmax(), image.shape)
        assert abs(column - u) <= 0.51 and abs(row - v) <= 0.51
        weight = image / image.sum()
        sds = [np.sqrt((weight * (k - c) ** 2).sum())
               for k, c in zip(np.indices(image.shape), (v, u))]
        assert sds[0] > 4 * sds[1]
        dry = np.zeros_like(image)
        streak(dry, eye, lamp, mirrored, 20000.0, 0.05, 0.0)
        assert not dry.any()


def test_highlight_is_where_paint_faces_the_sun_and_differs_between_views():
    # A pane of 1 m, bowed by 5 cm at its edges, upright across the line of sight at 20 m.
    bow_m, z_m, rows, columns = 0.05, 20.0, 48, 64
    x = (np.arange(columns) + 0.5) / columns * 2 - 1
    relief = np.repeat(-bow_m * x[None] ** 2, rows, axis=0).astype(np.float32)
    surface = Surface.of(relief, (1.0, 1.0), np.ones_like(relief))
    plane = Plane(np.array([-0.5, -0.5, z_m]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]),
                  Texture.plain(0.0), surface=surface)
    to_sun = np.array([0.12, 0.0, -1.0])
    sky = Sky.of(np.array([0, -1.0, 0]), np.array([0, 0, 1.0]), to_sun / np.linalg.norm(to_sun),
                 1.0, np.random.default_rng(0))
    scene = SimScene(straight_config())
    places = []
    for view in rig_views(scene.rig):
        eye, image = Eye(view), np.zeros((768, 1024), np.float32)
        eye.draw(image, plane, sky)
        light = image.sum(axis=0) * (image.sum(axis=0) > 0.5 * image.sum(axis=0).max())
        u = (light * np.arange(1024)).sum() / light.sum()

        # By hand: the normal is half-way between sun and camera, and its slope is 8 bow x.
        def turned(place_m):
            point = np.array([place_m, 0.0, z_m])
            back = view.centre_m - point
            half = back / np.linalg.norm(back) + sky.sun
            return half[0] / -half[2] - 8 * bow_m * place_m
        place_m = brentq(turned, -0.5, 0.5)
        (wanted, _), = eye.project(np.array([[place_m, 0.0, z_m]]))
        assert u == pytest.approx(wanted, abs=1.5)
        places.append(place_m)
    assert places[1] - places[0] > 0.02  # on the paint, m


def test_at_night_lamps_stay_bright_and_everything_else_is_dark():
    lit = VehicleConfig(solid=True, lamp_grey=20000.0)
    images = []
    for light in (None, WET_NIGHT):
        scene = SimScene(straight_config(vehicles=(lit,), light=light, noise_grey=0.0, lens=LENS))
        painter = Painter(scene, np.random.default_rng(0), np.random.default_rng(0))
        images.append(painter.paint(scene.vehicles, 1.5)[0][0])
    day, night = images
    assert np.median(night) < 0.3 * np.median(day)
    clipped = night == 255
    assert clipped.sum() > 20 and (day[clipped] == 255).all()
