# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The distance field against closed forms, brute force and OpenCV."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from stereo_speed.monocular.distance import boundary_points, DistanceField

ANGLES = (10, 37, 63, 128, 205)


def ring(centre, radius_px, count=180):
    """Return points (count, 2) of a circle and their unit radii."""
    turn = np.linspace(0, 2 * np.pi, count, endpoint=False) + 0.01
    radial = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return np.asarray(centre) + radius_px * radial, radial


def test_edge_along_the_grid_is_exact(maps):
    """Columns up to 99 are pathway: the boundary is at 99.5."""
    columns, _ = maps.pixels()
    field = DistanceField(maps.two_kinds(columns - 99.5))
    points = np.array([[99.5, 80.0], [99.87, 81.3], [90.25, 20.5], [150.0, 80.0]])
    np.testing.assert_allclose(field.distance(points), [0.0, 0.37, -9.25, 50.5], atol=1e-4)
    np.testing.assert_allclose(maps.unit_normal(field, points), [[1, 0]] * 4, atol=1e-4)


@pytest.mark.parametrize('angle_deg', ANGLES)
def test_slanting_edge_is_exact_to_a_quarter_of_a_pixel(maps, angle_deg):
    """Pixel labels locate a slanting line only to about that."""
    wanted = maps.edge_distance(angle_deg)
    field = DistanceField(maps.two_kinds(wanted))
    columns, rows = maps.pixels()
    near = (np.abs(wanted) < 30) & (np.hypot(columns - 100, rows - 80) < 50)
    error = field.signed_px[near] - wanted[near]
    assert np.abs(error).max() < 0.25
    assert abs(error.mean()) < 0.05
    points = np.stack([columns[near], rows[near]], axis=-1)
    turn = np.radians(angle_deg)
    across = maps.unit_normal(field, points) @ [np.cos(turn), np.sin(turn)]  # towards larger d
    assert np.degrees(np.arccos(np.clip(across, -1, 1))).max() < 8
    assert np.degrees(np.arccos(np.clip(across, -1, 1))).mean() < 2


@pytest.mark.parametrize('radius_px', [20.0, 40.0, 60.0])
def test_circle(maps, radius_px):
    """The distance is r - R between pixels too; smoothing takes sigma^2 / 2R off the circle."""
    field = DistanceField(maps.two_kinds(maps.circle_distance(radius_px)))
    for offset in (-12.3, -5.0, -0.4, 0.0, 0.6, 4.0, 9.7):
        points, radial = ring(maps.CENTRE, radius_px + offset)
        error = field.distance(points) - offset
        assert np.abs(error).max() < 0.4
        assert abs(error.mean() - 2.0 ** 2 / (2 * radius_px)) < 0.06
        assert np.sum(maps.unit_normal(field, points) * radial, axis=-1).min() > 0.99


def test_third_kind_elsewhere_has_no_effect(maps):
    """A boundary is then traced from both its sides; its distance must stay that of the line."""
    for angle_deg in (37, 45, 63):
        labels = maps.two_kinds(maps.edge_distance(angle_deg))
        three = labels.copy()
        three[:4, :4] = 0
        difference = DistanceField(labels).signed_px - DistanceField(three).signed_px
        assert np.abs(difference[40:120, 60:140]).max() < 0.02


def test_distance_near_the_boundary_equals_that_of_its_curve(maps):
    """Reference: the softened mask, enlarged 8 times, and OpenCV's exact transform of it."""
    labels = maps.smooth_map(4, blur_px=10.0, shape=(60, 80))
    soft = cv2.GaussianBlur((labels == 255).astype(np.float64), (0, 0), 2.0,
                            borderType=cv2.BORDER_REPLICATE)
    fine_y, fine_x = np.mgrid[:59 * 8 + 1, :79 * 8 + 1] / 8
    fine = map_coordinates(soft, [fine_y, fine_x], order=1) > 0.5
    outwards = cv2.distanceTransform((~fine).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    inwards = cv2.distanceTransform(fine.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    wanted = (np.where(fine, 0.5 - inwards, outwards - 0.5) / 8)[::8, ::8]
    found = np.abs(DistanceField(labels).signed_px) * np.where(soft > 0.5, -1, 1)
    near = np.abs(wanted) < 6
    assert np.abs(found - wanted)[near].max() < 0.2
    assert np.abs(found - wanted)[near].mean() < 0.04


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_random_map_against_brute_force(maps, seed):
    """Reference: the nearest of all sides between two pixels of different kind."""
    labels = maps.smooth_map(seed, blur_px=12.0, shape=(90, 120), kinds=3)
    row, column = np.nonzero(labels[:, :-1] != labels[:, 1:])
    sides = [np.stack([column + 0.5, row], axis=-1)]
    row, column = np.nonzero(labels[:-1] != labels[1:])
    sides.append(np.stack([column, row + 0.5], axis=-1))
    sides = np.concatenate(sides)
    y, x = np.mgrid[:90, :120]
    unsigned = np.hypot(x[..., None] - sides[:, 0], y[..., None] - sides[:, 1]).min(axis=-1)
    wanted = np.where(labels == 255, -unsigned, unsigned)
    wanted[labels == 0] = np.inf
    found = DistanceField(labels).distance(np.stack([x, y], axis=-1).astype(float))
    np.testing.assert_array_equal(np.isinf(found), labels == 0)
    finite = np.isfinite(wanted)
    # where the smoothing rounds a tip off, the boundary is a little farther
    error = np.abs(found[finite] - wanted[finite])
    assert np.mean(error < 1.0) > 0.99 and error.max() < 2.0 and error.mean() < 0.3


def test_random_map_against_opencv(maps):
    """Reference: distance to the nearest pixel of the other kind; the boundary is half-way."""
    labels = maps.smooth_map(5)
    path = (labels == 255).astype(np.uint8)
    outwards = cv2.distanceTransform(1 - path, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) - 0.5
    inwards = cv2.distanceTransform(path, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) - 0.5
    error = np.abs(DistanceField(labels).signed_px - np.where(path, -inwards, outwards))
    assert error.max() < 1.5 and error.mean() < 0.4


def test_lookup_is_bilinear_and_clamped_at_the_edge(maps):
    field = DistanceField(maps.smooth_map(6))
    points = np.random.default_rng(0).uniform((-9, -9), (maps.WIDTH + 9, maps.HEIGHT + 9),
                                              (400, 2))
    wanted = map_coordinates(field.signed_px.astype(float), points.T[::-1], order=1,
                             mode='nearest')
    np.testing.assert_allclose(field.level(points), wanted, atol=1e-4)
    np.testing.assert_array_equal(field.level_and_gradient(points)[0], field.level(points))
    assert field.level(points.reshape(20, 20, 2)).shape == (20, 20)


def test_inaccessible_is_infinite_per_pixel_but_level_is_not(maps):
    labels = np.full((40, 60), 128, np.uint8)
    labels[:, :20], labels[10:20, 40:50] = 255, 0
    field = DistanceField(labels)
    points = np.array([[45.0, 15.0], [39.51, 15.0], [39.49, 15.0], [10.0, 5.0], [-4.0, 5.0]])
    np.testing.assert_array_equal(field.accessible(points), [False, False, True, True, True])
    np.testing.assert_array_equal(np.isinf(field.distance(points)), [True, True] + [False] * 3)
    assert np.all(np.isfinite(field.level(points))) and field.level(points)[0] > 0
    assert field.distance(points)[3] == pytest.approx(-9.5, abs=1e-3)
    assert field.distance(points)[4] == pytest.approx(-19.5, abs=1e-3)  # that of the edge


def test_nothing_is_inaccessible_beyond_the_image():
    labels = np.zeros((20, 30), np.uint8)
    field = DistanceField(labels)
    points = np.array([[-0.6, 5.0], [-0.4, 5.0], [29.4, 19.4], [29.6, 5.0], [5.0, 19.6]])
    np.testing.assert_array_equal(field.accessible(points), [True, False, False, True, True])


@pytest.mark.parametrize('grey', [255, 128])
def test_map_of_one_kind_is_far_from_everything(grey):
    field = DistanceField(np.full((30, 40), grey, np.uint8))
    point = np.array([[3.2, 4.5]])
    assert len(boundary_points(field.labels)) == 0
    assert field.distance(point) == pytest.approx(-50 if grey == 255 else 50)
    np.testing.assert_array_equal(field.level_and_gradient(point)[1], [[0, 0]])


def test_ridge_has_a_short_gradient():
    """In the middle of a lane both its edges are equally near."""
    labels = np.full((60, 80), 128, np.uint8)
    labels[20:41] = 255
    field = DistanceField(labels)
    points = np.array([[40.0, 30.0], [40.0, 24.0]])
    gradient = np.linalg.norm(field.level_and_gradient(points)[1], axis=-1)
    assert gradient[0] < 0.05 and gradient[1] == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize('shape', [(1, 1), (1, 30), (30, 1)])
def test_map_one_pixel_wide_is_far_from_everything(shape):
    """It has no boundary curve, and no slope across it."""
    labels = np.full(shape, 128, np.uint8)
    labels[:15, :15] = 255
    field = DistanceField(labels)
    level, gradient = field.level_and_gradient(np.array([[0.0, 0.0]]))
    assert level == pytest.approx(-np.hypot(*shape)) and not gradient.any()
