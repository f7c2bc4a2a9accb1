# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Rendered objects agree with the geometry to a small part of a pixel."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from stereo_speed.geometry.camera import Camera
from stereo_speed.lab.sim import (
    circle_config, RIGS, RoadConfig, straight_config, VehicleConfig)
from stereo_speed.lab.sim.appearance import Appearance
from stereo_speed.lab.sim.planes import Eye, Texture
from stereo_speed.lab.sim.scene import SimScene
from stereo_speed.lab.sim.scenery import GroundMap, marking_coverage
from stereo_speed.lab.sim.texture import front_texture, octaves, pyramid
from stereo_speed.lab.sim.view import below, rig_views, View

CLOTHOID = RoadConfig(curvature_start=0.004, curvature_end=0.035, clothoid_m=40.0, grade=0.03)
BACK = 60.0


def _box(uv):
    low, high = np.floor(uv.min(axis=0)).astype(int) - 2, np.ceil(uv.max(axis=0)).astype(int) + 3
    return low[0], high[0], low[1], high[1]


def _appearance(vehicle, seed=5):
    return Appearance(vehicle.body, False, np.random.default_rng(seed))


def _draw(view, plane, box, back=BACK):
    image = np.full((768, 1024), back, np.float32)
    Eye(view).draw(image, plane)
    return image[box[2]:box[3], box[0]:box[1]]


def _texels(texture):
    columns, rows = texture.size
    return texture.grey[0][:rows, :columns]


def _sample(image, x, y, size_m):
    """Sample an image at metres from the top-left corner of its plane."""
    rows, columns = image.shape
    return map_coordinates(image, [y * rows / size_m[1] - 0.5, x * columns / size_m[0] - 0.5],
                           order=1, mode='nearest')


def _brute(camera, corners_px, texture, size_m, box):
    """Draw the front by a homography of its projected corners, with many samples per pixel."""
    u0, u1, v0, v1 = box
    w, h = size_m
    flat = camera.undistort(corners_px)
    # Solved here in double: cv2.getPerspectiveTransform takes corners in float32.
    a, b = [], []
    for (x, y), (p, q) in zip(flat, [(0, 0), (w, 0), (w, h), (0, h)]):
        a += [[x, y, 1, 0, 0, 0, -p * x, -p * y], [0, 0, 0, x, y, 1, -q * x, -q * y]]
        b += [p, q]
    texture_H_image = np.append(np.linalg.solve(a, b), 1.0).reshape(3, 3)
    fine = int(np.clip(900 // (u1 - u0), 8, 14))
    steps = (np.arange(fine) + 0.5) / fine - 0.5
    uv = np.stack(np.meshgrid((np.arange(u0, u1)[:, None] + steps).ravel(),
                              (np.arange(v0, v1)[:, None] + steps).ravel()), axis=-1)
    xyw = camera.rays(uv) @ texture_H_image.T
    x, y = xyw[..., 0] / xyw[..., 2], xyw[..., 1] / xyw[..., 2]
    inside = (x >= 0) & (x <= w) & (y >= 0) & (y <= h)
    image = np.where(inside, _sample(_texels(texture), x, y, size_m), BACK)
    return image.reshape(v1 - v0, fine, u1 - u0, fine).mean(axis=(1, 3))


def _shift(image, reference):
    """Return the offset of an image to the right of and below its reference, px."""
    mean = (image + reference) / 2
    gy, gx = np.gradient(mean)
    terms = np.stack([gx.ravel(), gy.ravel(), np.ones(gx.size), mean.ravel()], axis=1)
    return -np.linalg.lstsq(terms, (image - reference).ravel(), rcond=None)[0][:2]


@pytest.mark.parametrize('rig', sorted(RIGS))
@pytest.mark.parametrize('make', [straight_config, circle_config])
def test_front_is_drawn_where_it_projects(make, rig):
    scene = SimScene(make(rig=RIGS[rig]))
    vehicle = scene.vehicles[0]
    appearance = _appearance(vehicle)
    size_m = vehicle.body.width_m, vehicle.body.front_m
    for t_s in (0.0, 1.4):
        pose = scene.front(vehicle, t_s)
        shifts = []
        for view, corners in zip(rig_views(scene.rig), scene.rig.project(pose.corners_m)[:2]):
            box = _box(corners)
            image = _draw(view, appearance.planes(pose)[-1], box)
            shifts.append(_shift(image, _brute(
                view.camera, corners, appearance.tracked, size_m, box)))
        assert np.abs(shifts).max() < 0.01
        assert abs(shifts[0][0] - shifts[1][0]) < 0.01  # disparity


def _forward(project, pose, appearance, box):
    """Draw a front with relief by projecting its surface, with many small pieces per pixel."""
    u0, u1, v0, v1 = box
    w, h = size_m = appearance.body.width_m, appearance.body.tracked_m(appearance.rear)
    x, y = np.meshgrid((np.arange(1200) + 0.5) * w / 1200, (np.arange(600) + 0.5) * h / 600)
    out = _sample(appearance.relief_m, x, y, size_m)
    corners = pose.corners_m
    across, down = (corners[1] - corners[0]) / w, (corners[3] - corners[0]) / h
    points = (corners[0] + x[..., None] * across + y[..., None] * down
              + out[..., None] * np.cross(down, across))
    uv = project(points)
    (uy, ux), (vy, vx) = (np.gradient(uv[..., k]) for k in (0, 1))
    areas = ux * vy - uy * vx  # of the pieces, px^2
    cell = (np.rint(uv[..., 1]) - v0) * (u1 - u0) + np.rint(uv[..., 0]) - u0
    grey = _sample(_texels(appearance.tracked), x, y, size_m)
    total, cover = (np.bincount(cell.astype(int).ravel(), weights=part.ravel(),
                                minlength=(u1 - u0) * (v1 - v0)).reshape(v1 - v0, u1 - u0)
                    for part in (areas * grey, areas))
    return total + (1 - cover) * BACK


@pytest.mark.parametrize('receding', [(), (0,)])
@pytest.mark.parametrize('kind', ['', 'van'])
def test_relief_is_drawn_where_its_surface_projects(kind, receding):
    config = straight_config(
        rig=RIGS['distorted'], road=RoadConfig(receding=receding),
        vehicles=(VehicleConfig(kind=kind, relief_m=0.05),))
    scene = SimScene(config)
    vehicle = scene.vehicles[0]
    appearance = Appearance(vehicle.body, bool(receding), np.random.default_rng(3))
    assert appearance.relief_m.std() == pytest.approx(0.05)
    pose = scene.front(vehicle, 0.9)
    plane = appearance.planes(pose)[-1]
    shifts = []
    for side, view in enumerate(rig_views(scene.rig)):
        box = _box(scene.rig.project(pose.corners_m)[side] + [[-6, -6], [6, -6], [6, 6], [-6, 6]])
        true = _forward(lambda points: scene.rig.project(points)[side], pose, appearance, box)
        image, flat = (_draw(view, p, box) for p in (plane, replace(plane, relief_m=None)))
        # In tiles of a quarter of its size, each at its own depth.
        rows, columns = (np.array_split(np.arange(n), 4) for n in image.shape)
        gaps = [_shift(image[np.ix_(r, c)], true[np.ix_(r, c)])
                for r in rows[1:3] for c in columns[1:3]]
        assert np.abs(gaps).max() < 0.03
        shifts.append(_shift(image, true))
        assert np.sqrt(np.mean((image - true) ** 2)) < 0.3 * np.sqrt(np.mean((flat - true) ** 2))
    assert np.abs(shifts).max() < 0.01
    assert abs(shifts[0][0] - shifts[1][0]) < 0.01


def test_uniform_front_has_its_centroid_at_the_projected_area():
    scene = SimScene(straight_config())
    vehicle = scene.vehicles[0]
    for t_s in (0.0, 1.3):
        pose = scene.front(vehicle, t_s)
        plane = replace(_appearance(vehicle).planes(pose)[-1], texture=Texture.plain(100.0))
        for view, corners in zip(rig_views(scene.rig), scene.rig.project(pose.corners_m)[:2]):
            image = _draw(view, plane, (0, 1024, 0, 768), 0.0)
            x, y = corners.T
            cross = x * np.roll(y, -1) - np.roll(x, -1) * y
            area = cross.sum() / 2
            centroid = [((c + np.roll(c, -1)) * cross).sum() / (6 * area) for c in (x, y)]
            v, u = np.indices(image.shape)
            found = [float((image * c).sum() / image.sum()) for c in (u, v)]
            np.testing.assert_allclose(found, centroid, atol=2e-3)
            assert float(image.sum()) / 100.0 == pytest.approx(area, rel=2e-4)


def test_contrast_scales_the_detail_about_the_mean():
    for rear in (False, True):
        one, half = (Appearance(VehicleConfig(texture_contrast=c).body, rear,
                                np.random.default_rng(0)).tracked.grey[0] for c in (1.0, 0.5))
        np.testing.assert_allclose(half - one.mean(), 0.5 * (one - one.mean()), atol=1e-3)


@pytest.mark.parametrize('config', [
    pytest.param(straight_config(rig=RIGS['distorted']), id='straight'),
    pytest.param(circle_config(), id='circle'),
    pytest.param(circle_config(road=CLOTHOID, rig=RIGS['equidistant']), id='graded',
                 marks=pytest.mark.slow)])
def test_markings_lie_on_the_lines(config):
    scene = SimScene(config)
    stations = np.linspace(5.0, scene.end_station_m, 40)
    offset = scene.road.line_offsets()['edge_right']
    for view in rig_views(scene.rig):
        share = marking_coverage(GroundMap(scene, view), scene.road)
        # The projected middle of a strip, not of its line: perspective shifts it a little.
        edges = [view.project(scene.to_left(scene.road.position(
            np.linspace(-5.0, 70.0, 20001), np.full(20001, offset + side * 0.075))))[0]
            for side in (-1.0, 1.0)]
        middles, valid = view.project(scene.to_left(
            scene.road.position(stations, np.full(40, offset))))
        gaps = []
        for u, v in middles[valid]:
            v = round(v)
            low, high = max(round(u) - 15, 0), round(u) + 16
            row = share[v, low:high]
            crossing, slope = [], 0.0
            for edge in edges:
                k = np.flatnonzero((edge[:-1, 1] - v) * (edge[1:, 1] - v) <= 0)
                k = k[np.abs(edge[k, 0] - u) < 15]
                crossing.append(edge[k, 0].mean() if len(k) == 1 else np.nan)
                if len(k) == 1:
                    step = edge[k[0] + 1] - edge[k[0]]
                    slope = step[0] / step[1]
            if row[0] + row[-1] < 1e-9 and len(row) == 31 and row.max() > 0.2:
                centroid = (row * np.arange(low, high)).sum() / row.sum()
                gaps.append((centroid - np.mean(crossing)) / np.hypot(1.0, slope))
        gaps = np.array(gaps)[np.isfinite(gaps)]
        assert len(gaps) > 8
        assert np.abs(np.median(gaps)) < 0.01
        assert np.percentile(np.abs(gaps), 90) < 0.05


@pytest.mark.parametrize('model', ['plumb_bob', 'rational', 'equidistant'])
def test_rays_on_a_grid_equal_the_cameras(model):
    rig = SimScene(straight_config(
        rig=RIGS['distorted' if model == 'plumb_bob' else model])).rig
    view = View(rig.right, rig.R, rig.t)
    u, v = np.linspace(-0.5, 1023.5, 40), np.linspace(-0.5, 767.5, 31)
    rays = view.ray_grid(u, v)
    uv = np.stack(np.meshgrid(u, v), axis=-1)
    wanted = rig.right.rays(uv)
    np.testing.assert_allclose(rays @ rig.R.T, wanted, atol=1e-4 / 1800)


def test_coverage_by_brute_force():
    rng = np.random.default_rng(2)
    x, y = np.meshgrid(*2 * [(np.arange(400) + 0.5) / 400 - 0.5])
    for _ in range(20):
        gx, gy, gap = rng.uniform(-1, 1, 3)
        share = np.mean(gx * x + gy * y < gap)
        assert float(below(np.array(gap), np.array(gx), np.array(gy))) == pytest.approx(
            share, abs=5e-3)


def test_pyramid_keeps_means_and_textures_differ():
    rng = np.random.default_rng(0)
    one, other = (front_texture(rng, 1.8, 0.8) for _ in range(2))
    assert one.shape == (200, 450) and not np.allclose(one, other)
    assert 10 < one.std() < 80
    levels = pyramid(octaves(rng, 64, 64, 2), 3)
    assert [level.shape for level in levels] == [(64, 64), (32, 32), (16, 16), (8, 8)]
    np.testing.assert_allclose(levels[3].mean(), levels[0].mean(), atol=1e-5)


def test_undistorted_rays_are_exact():
    camera = Camera('left', 64, 48, np.array([[50.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]]),
                    np.zeros(5), 'plumb_bob')
    rays = View(camera, np.eye(3), np.zeros(3)).ray_grid(np.array([31.5, 81.5]), np.array([83.5]))
    np.testing.assert_allclose(rays, [[[0, 1, 1], [1, 1, 1]]])
