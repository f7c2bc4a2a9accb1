# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Maps whose distance is known in closed form, and a synthetic road seen by one camera."""
from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from stereo_speed.monocular.distance import DistanceField

WIDTH, HEIGHT = 200, 160
CENTRE = (99.3, 80.2)  # of the round map, between pixels
RED, BLUE = (40, 40, 210), (200, 60, 30)  # BGR


def pixels():
    """Return the columns and rows (H, W) of the maps."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    return columns, rows


def two_kinds(distance_px):
    """Draw a map whose pathway is where a distance is negative."""
    return np.where(distance_px < 0, 255, 128).astype(np.uint8)


def edge_distance(angle_deg, offset=0.37):
    """Return the distance (H, W) to a line through the image's middle with a normal's angle."""
    columns, rows = pixels()
    turn = np.radians(angle_deg)
    return (columns - 100 - offset) * np.cos(turn) + (rows - 80) * np.sin(turn)


def circle_distance(radius_px):
    """Return the distance (H, W) to a circle, negative inside."""
    columns, rows = pixels()
    return np.hypot(columns - CENTRE[0], rows - CENTRE[1]) - radius_px


def smooth_map(seed, blur_px=14.0, shape=(HEIGHT, WIDTH), kinds=2):
    """Draw a random map with round boundaries."""
    rng = np.random.default_rng(seed)
    hills = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), blur_px)
    labels = np.where(hills < 0, 255, 128).astype(np.uint8)
    if kinds > 2:
        labels[cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), blur_px)
               > 0.7 * hills.std()] = 0
    return labels


def unit_normal(field, points):
    """Return the normals (n, 2) of the contours, of length 1."""
    gradient = field.level_and_gradient(points)[1]
    return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)


class Road:
    """
    A textured plane, and coloured blocks that move over it on arcs about its corner.

    :param radius_px: of the middle of the road, a ring 36 px wide.
    """

    size = (240, 200)  # width, height
    corner = np.array([20.0, 190.0])

    def __init__(self, radius_px=130.0):
        self.radius_px = radius_px
        width, height = self.size
        rows, columns = np.mgrid[:height, :width].astype(float)
        from_corner = np.hypot(columns - self.corner[0], rows - self.corner[1])
        self.map = np.where(np.abs(from_corner - radius_px) < 18, 255, 128).astype(np.uint8)
        noise = np.random.default_rng(9).normal(0, 12, (height, width, 3))
        ground = np.where(self.map[..., None] == 255, (110, 112, 115), (70, 130, 90))
        self.ground = np.clip(ground + cv2.GaussianBlur(noise, (0, 0), 1.0), 0, 255)
        self.field = DistanceField(self.map)

    def place(self, frame, radius_px=None, start_deg=80.0, step_deg=1.6):
        """Return the centre (2,) of a block in a frame and its rotation; it moves clockwise."""
        turn = np.radians(start_deg - step_deg * (frame - 1))
        radius = self.radius_px if radius_px is None else radius_px
        centre = self.corner + radius * np.array([np.cos(turn), -np.sin(turn)])
        return centre, np.pi / 2 - turn

    def image(self, blocks, seed):
        """
        Draw a frame.

        :param blocks: (centre, angle, (w, h), colour) each.
        """
        image = self.ground.copy()
        for centre, angle, size, colour in blocks:
            box = cv2.boxPoints((tuple(map(float, centre)), size, float(np.degrees(angle))))
            cv2.fillConvexPoly(image, np.rint(box * 16).astype(np.int32), colour, shift=4)
        image += np.random.default_rng(seed).normal(0, 3, image.shape)
        return np.clip(image, 0, 255).astype(np.uint8)


@pytest.fixture(scope='session')
def road():
    """Return the road."""
    return Road()


@pytest.fixture()
def maps():
    """Return all helpers above, without an import between test files."""
    return SimpleNamespace(
        WIDTH=WIDTH, HEIGHT=HEIGHT, CENTRE=CENTRE, RED=RED, BLUE=BLUE, pixels=pixels,
        two_kinds=two_kinds, edge_distance=edge_distance, circle_distance=circle_distance,
        smooth_map=smooth_map, unit_normal=unit_normal)
