# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Vehicles drawn over the background by inverse mapping.

The front is exact well below a hundredth of a pixel: each sub-pixel's ray goes through the true
camera, meets the front's plane, and takes the texture averaged to about its own footprint.
"""
from __future__ import annotations

import cv2
import numpy as np

from .config import VehicleConfig
from .scene import FrontPose
from .texture import front_texture, Image, octaves, pyramid
from .view import below, View
from ...core.records import Array

SUB = 4  # sub-pixels across and down a pixel
LEVELS = 6
RELIEF_BUMPS = 12  # of the front's relief, side by side, are the finest
RELIEF_STEPS = 4  # of the search for where a ray meets the relief
BONNET_M, SCREEN_M, ROOF_M = 1.1, 1.8, 4.2  # behind the front
_SHIFT = 4  # fractional bits of polygon corners


class VehicleLook:
    """
    What a vehicle looks like.

    :param config: the vehicle.
    :param rng: source of its texture.
    """

    def __init__(self, config: VehicleConfig, rng: np.random.Generator) -> None:
        self.config = config
        image = front_texture(
            rng, config.front_width_m, config.front_height_m, config.texture_contrast)
        self.texel_m = (config.front_width_m / image.shape[1],
                        config.front_height_m / image.shape[0])
        self.levels = pyramid(image, LEVELS)
        self.paint = float(np.median(image))
        self.glass = float(rng.uniform(25, 45))
        self.relief_m = None if config.relief_m == 0 else config.relief_m * octaves(
            rng, *image.shape, max(image.shape) // RELIEF_BUMPS)

    def depth_m(self, x_m: Array, y_m: Array) -> Array:
        """Return how far the front stands out of its plane at places on it, m."""
        return cv2.remap(self.relief_m, (x_m / self.texel_m[0] - 0.5).astype(np.float32),
                         (y_m / self.texel_m[1] - 0.5).astype(np.float32), cv2.INTER_LINEAR,
                         borderMode=cv2.BORDER_REPLICATE)


def _sample(look: VehicleLook, x_m: Array, y_m: Array, footprint_m: float) -> Array:
    """
    Sample the front's texture, averaged to a footprint.

    :param x_m: metres from its left edge as seen by the camera.
    :param y_m: metres from its upper edge.
    :param footprint_m: size of what is averaged, m.
    """
    level = float(np.clip(np.log2(max(footprint_m / look.texel_m[0], 1.0)), 0, LEVELS - 1))
    out = np.zeros(x_m.shape)
    for i, weight in ((int(level), 1 - level % 1), (int(level) + 1, level % 1)):
        if weight == 0:
            continue
        x = x_m / (look.texel_m[0] * 2 ** i) - 0.5
        y = y_m / (look.texel_m[1] * 2 ** i) - 0.5
        out = out + weight * cv2.remap(
            look.levels[i], x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE)
    return out


def _region(view: View, points_m: Array) -> tuple[int, int, int, int]:
    """Return first and last columns and rows (half open) that points may touch."""
    uv, _ = view.project(points_m)
    low = np.floor(np.nanmin(uv, axis=0)).astype(int) - 2
    high = np.ceil(np.nanmax(uv, axis=0)).astype(int) + 3
    u0, v0 = np.maximum(low, 0)
    return (u0, min(high[0], view.camera.width_px), v0, min(high[1], view.camera.height_px))


def draw_front(image: Image, view: View, look: VehicleLook, pose: FrontPose) -> None:
    """
    Draw the textured front into an image, in place.

    :param image: (rows, columns) float32.
    :param view: the view.
    :param look: the vehicle's look.
    :param pose: the front's place.
    """
    u0, u1, v0, v1 = _region(view, pose.corners_m)
    if u0 >= u1 or v0 >= v1:
        return
    offsets = (np.arange(SUB) + 0.5) / SUB - 0.5
    u = (np.arange(u0, u1)[:, None] + offsets).ravel()
    v = (np.arange(v0, v1)[:, None] + offsets).ravel()
    rays = view.ray_grid(u, v)
    along, left, up = pose.axes.T
    gap = pose.corners_m[0] - view.centre_m
    depth = (gap @ along) / (rays @ along)
    x = depth * (rays @ left) - gap @ left
    y = -(depth * (rays @ up) - gap @ up)
    for _ in range(RELIEF_STEPS if look.relief_m is not None else 0):
        depth = (gap @ along + look.depth_m(x, y)) / (rays @ along)
        x = depth * (rays @ left) - gap @ left
        y = -(depth * (rays @ up) - gap @ up)
    xu, xv = np.gradient(x, axis=1), np.gradient(x, axis=0)
    yu, yv = np.gradient(y, axis=1), np.gradient(y, axis=0)
    width, height = look.config.front_width_m, look.config.front_height_m
    cover = ((below(width - x, xu, xv) - below(-x, xu, xv))
             * (below(height - y, yu, yv) - below(-y, yu, yv)))
    grey = _sample(look, np.clip(x, 0, width), np.clip(y, 0, height),
                   float(np.mean(np.hypot(xu, xv))))
    shape = (v1 - v0, SUB, u1 - u0, SUB)
    alpha = cover.reshape(shape).mean(axis=(1, 3))
    colour = (cover * grey).reshape(shape).mean(axis=(1, 3))
    target = image[v0:v1, u0:u1]
    target[...] = colour + (1 - alpha) * target


def _body_faces(look: VehicleLook, pose: FrontPose) -> list[tuple[Array, float]]:
    """Return the plain faces (n, 3) behind the front, in the order of drawing, with greys."""
    c = look.config
    top, half = c.clearance_m + c.front_height_m, c.front_width_m / 2
    roof = max(1.45, top + 0.25)

    def at(back: float, side: float, height: float) -> Array:
        return pose.ground_m + pose.axes @ np.array([-back, side, height])

    def across(back0: float, h0: float, back1: float, h1: float, narrow: float) -> Array:
        return np.stack([at(back0, -half, h0), at(back0, half, h0),
                         at(back1, half - narrow, h1), at(back1, -half + narrow, h1)])
    faces = [(np.stack([at(-0.15, -half - 0.1, 0), at(-0.15, half + 0.1, 0),
                        at(ROOF_M, half + 0.1, 0), at(ROOF_M, -half - 0.1, 0)]), 28.0)]
    for side in (-half, half):
        faces.append((np.stack([
            at(0, side, c.clearance_m), at(0, side, top), at(BONNET_M, side, top + 0.1),
            at(SCREEN_M, side, roof), at(ROOF_M, side, roof),
            at(ROOF_M, side, c.clearance_m)]), look.paint * 0.6))
        for wheel in (0.7, 3.4):
            faces.append((np.stack([at(wheel - 0.3, side, 0), at(wheel + 0.3, side, 0),
                                    at(wheel + 0.3, side, 0.6), at(wheel - 0.3, side, 0.6)]),
                          22.0))
    for side in (-half, half - 0.2):  # the front tyres below the front
        faces.append((np.stack([at(0.1, side, 0), at(0.1, side + 0.2, 0),
                                at(0.1, side + 0.2, c.clearance_m + 0.02),
                                at(0.1, side, c.clearance_m + 0.02)]), 20.0))
    faces += [(across(SCREEN_M, roof, ROOF_M, roof, 0.0), look.paint * 1.1),
              (across(BONNET_M, top + 0.1, SCREEN_M, roof, 0.0), look.glass),
              (across(0.0, top, BONNET_M, top + 0.1, 0.0), look.paint * 1.05)]
    return faces


def _facing(face: Array, inside: Array, eye: Array) -> bool:
    """Say whether a face of a convex body turns its outer side to the eye."""
    normal = np.cross(face[1] - face[0], face[2] - face[0])
    return bool((normal @ (face[0] - inside)) * (normal @ (eye - face[0])) > 0)


def draw_body(image: Image, view: View, look: VehicleLook, pose: FrontPose) -> None:
    """Draw the plain body behind the front, in place; its edges are good to a tenth of a px."""
    faces = _body_faces(look, pose)
    inside = pose.ground_m + pose.axes @ np.array([-2.0, 0.0, 0.5])
    u0, u1, v0, v1 = _region(view, np.concatenate([face for face, _ in faces]))
    if u0 >= u1 or v0 >= v1:
        return
    for i, (face, grey) in enumerate(faces):
        if i and not _facing(face, inside, view.centre_m):  # the first is the shadow
            continue
        uv, _ = view.project(face)
        if not np.isfinite(uv).all():
            continue
        mask = np.zeros(((v1 - v0) * SUB, (u1 - u0) * SUB), np.uint8)
        corners = (uv - [u0, v0] + 0.5) * SUB - 0.5
        cv2.fillPoly(mask, [np.round(corners * 2 ** _SHIFT).astype(np.int32)], 255,
                     cv2.LINE_8, _SHIFT)
        share = cv2.resize(mask.astype(np.float32) / 255, (u1 - u0, v1 - v0),
                           interpolation=cv2.INTER_AREA)
        target = image[v0:v1, u0:u1]
        target += share * (grey - target)
