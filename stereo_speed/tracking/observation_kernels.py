# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels of fronts and observations: points of a front, and its grey values in a view."""
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from ..core.compiled import inlined, kernel
from ..core.records import Array
from ..vision.sampling import Patches

_LEAST_SCALE = 1e-6  # grey levels: a patch without contrast must not divide by zero
_LEAST_OUTLINE = 1e-9


def plain_points(positions: Array, frames: Array, beside: Array, on_vehicle: Array) -> Array:
    """
    Return points (N, M, 3) of a front for many poses.

    :param positions: (N, 3) of the path.
    :param frames: (N, 3, 3) of the path.
    :param beside: (N, 2) offsets of each pose to the left and up, m.
    :param on_vehicle: (M, 3) the points ahead, to the left and above the front's centre, m.
    """
    offset = on_vehicle[None] + np.concatenate(
        [np.zeros((len(beside), 1)), beside], axis=1)[:, None]
    return np.asarray(positions[:, None] + offset @ np.swapaxes(frames, 1, 2))


@kernel(plain_points, '(f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1])')
def points(positions: Any, frames: Any, beside: Any, on_vehicle: Any) -> Any:
    """Return points; arguments as :func:`plain_points`."""
    out = np.empty((len(positions), len(on_vehicle), 3))
    for i in range(len(positions)):
        for d in range(3):
            t, p, b = frames[i, d, 0], frames[i, d, 1], frames[i, d, 2]
            here = positions[i, d] + p * beside[i, 0] + b * beside[i, 1]
            for j in range(len(on_vehicle)):
                out[i, j, d] = (here + t * on_vehicle[j, 0] + p * on_vehicle[j, 1]
                                + b * on_vehicle[j, 2])
    return out


def plain_spread(uv: Array, rows: int, columns: int, step_m: float
                 ) -> tuple[Array, Array, Array, Array, float]:
    """
    Return how the samples of a view lie and move, and how large its front is.

    :param uv: (4, G + 4, 2) pixels of samples and corners at a pose, and a step further along
        each of its axes.
    :param rows: of the grid of samples.
    :param columns: of it.
    :param step_m: the step.
    :return: (3, G, 2) derivatives of the samples, px/m; (3, 2) their means; (2, 2) bounds of the
        samples, least and greatest; (2,) distance of neighbours, down and across; area of the
        quad of the corners, px^2.
    """
    samples = rows * columns
    motion = (uv[1:, :samples] - uv[0, :samples]) / step_m
    at, (x, y) = uv[0, :samples], uv[0, samples:].T
    grid = at.reshape(rows, columns, 2)
    apart = np.array([np.linalg.norm(np.diff(grid, axis=k), axis=-1).mean() for k in (0, 1)])
    area = abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2
    return motion, motion.mean(axis=1), np.stack([at.min(axis=0), at.max(axis=0)]), apart, area


@kernel(plain_spread, '(f8[:,:,::1], i8, i8, f8)')
def spread(uv: Any, rows: Any, columns: Any, step_m: Any) -> Any:
    """Return how samples lie; arguments as :func:`plain_spread`."""
    samples = rows * columns
    motion, centre = np.empty((3, samples, 2)), np.zeros((3, 2))
    bounds, apart = np.empty((2, 2)), np.zeros(2)
    bounds[0], bounds[1] = np.inf, -np.inf
    for d in range(2):
        for g in range(samples):
            bounds[0, d] = min(bounds[0, d], uv[0, g, d])
            bounds[1, d] = max(bounds[1, d], uv[0, g, d])
            for c in range(3):
                motion[c, g, d] = (uv[c + 1, g, d] - uv[0, g, d]) / step_m
                centre[c, d] += motion[c, g, d] / samples
    for i in range(rows):
        for j in range(columns):
            g = i * columns + j
            if i + 1 < rows:
                h = g + columns
                apart[0] += np.hypot(uv[0, h, 0] - uv[0, g, 0], uv[0, h, 1] - uv[0, g, 1])
            if j + 1 < columns:
                h = g + 1
                apart[1] += np.hypot(uv[0, h, 0] - uv[0, g, 0], uv[0, h, 1] - uv[0, g, 1])
    apart[0] /= (rows - 1) * columns
    apart[1] /= rows * (columns - 1)
    area = 0.0
    for k in range(4):
        a, b = samples + k, samples + (k + 1) % 4
        area += uv[0, a, 0] * uv[0, b, 1] - uv[0, a, 1] * uv[0, b, 0]
    return motion, centre, bounds, apart, abs(area) / 2


class View(NamedTuple):
    """What one view adds to an observation, as documented there."""

    patch: Array
    jacobian: Array
    relief_jacobian: Array
    outline: Array


def plain_view(smooth: Patches, near: Patches, u: Array, v: Array, motion: Array
               ) -> tuple[Array, Array, Array, Array]:
    """
    Return the patch of a view, its derivatives by pose and relief, and its outline.

    :param smooth: (h, w) a crop of the view, low-passed.
    :param near: (h, w) where it is clipped, low-passed as well; (0, 0) where nothing is.
    :param u: (G,) columns of the samples.
    :param v: (G,) rows of the samples.
    :param motion: (3 k, G, 2) derivatives of the samples' places, px/m, of which those that are
        numbered 0, 3, … are by s.
    :return: (G,), (3 k, G), (k, G) those by s before the patch is normalised, (G,).
    """
    at, spline = np.stack([v, u]), ndimage.spline_filter(smooth, 3, np.float64)
    values = ndimage.map_coordinates(spline, at, order=3, mode='nearest', prefilter=False)
    scale = max(float(values.std()), _LEAST_SCALE)
    patch = (values - values.mean()) / scale
    slopes = [np.asarray(slope) for slope in np.gradient(smooth)]
    by_v, by_u = (_between(slope, at) / scale for slope in slopes)
    jacobian = motion[..., 0] * by_u + motion[..., 1] * by_v  # (3, G)
    change = normalised_change(jacobian, patch)
    if not near.size:
        return patch, change, jacobian[::3], np.zeros_like(patch)
    outline = normalised_change(_between(np.hypot(*slopes) * near, at)[None], patch)[0]
    outline = outline / max(float(np.linalg.norm(outline)), _LEAST_OUTLINE)
    return patch, change - np.outer(change @ outline, outline), jacobian[::3], outline


def _between(image: Patches, at: Array) -> Array:
    return np.asarray(ndimage.map_coordinates(
        image, at, np.float64, order=1, mode='nearest', prefilter=False))


def normalised_change(jacobian: Array, patches: Array) -> Array:
    """
    Return the derivatives of patches that are kept at zero mean and unit variance.

    :param jacobian: (..., 3, G) derivatives of the grey values before, per their deviation.
    :param patches: (..., G).
    :return: (..., 3, G), without any part along a constant or the patch itself.
    """
    jacobian = jacobian - jacobian.mean(axis=-1, keepdims=True)
    along = jacobian @ patches[..., None] / patches.shape[-1]
    return np.asarray(jacobian - along * patches[..., None, :])


@inlined
def _down(image):  # type: ignore
    """
    Return the spline coefficients of each column, as rows: from (h, w) to (w, h).

    The columns are filtered together, and mirrored at their ends.  Unser 1999, "Splines: a perfect
    fit for signal and image processing".
    """
    height, width = image.shape
    c = np.empty((height, width))
    for i in range(height):
        for j in range(width):
            c[i, j] = 6.0 * image[i, j] if height > 1 else image[i, j]
    if height > 1:
        z = np.sqrt(3.0) - 2.0
        last = z ** (height - 1)
        power = z
        for j in range(width):
            c[0, j] += last * c[height - 1, j]
        for i in range(1, height - 1):
            for j in range(width):
                c[0, j] += power * (c[i, j] + last * c[height - 1 - i, j])
            power *= z
        for j in range(width):
            c[0, j] /= 1 - last * last
        for i in range(1, height):
            for j in range(width):
                c[i, j] += z * c[i - 1, j]
        for j in range(width):
            c[height - 1, j] = (z * c[height - 2, j] + c[height - 1, j]) * z / (z * z - 1)
        for i in range(height - 2, -1, -1):
            for j in range(width):
                c[i, j] = z * (c[i + 1, j] - c[i, j])
    out = np.empty((width, height))
    for i in range(height):
        for j in range(width):
            out[j, i] = c[i, j]
    return out


@inlined
def _slope_down(image, i, j):  # type: ignore
    """Return the slope from row to row, one-sided at the edges."""
    a, b = max(i - 1, 0), min(i + 1, image.shape[0] - 1)
    return np.float32((image[b, j] - image[a, j]) / (b - a))


@inlined
def _slope_across(image, i, j):  # type: ignore
    """Return the slope from column to column, one-sided at the edges."""
    a, b = max(j - 1, 0), min(j + 1, image.shape[1] - 1)
    return np.float32((image[i, b] - image[i, a]) / (b - a))


@inlined
def _settle(change, patch):  # type: ignore
    """Take the parts along a constant and along the patch away from a row."""
    samples = len(patch)
    mean = 0.0
    for g in range(samples):
        mean += change[g]
    mean /= samples
    along = 0.0
    for g in range(samples):
        change[g] -= mean
        along += change[g] * patch[g]
    along /= samples
    for g in range(samples):
        change[g] -= along * patch[g]


@kernel(plain_view, '(f4[:,::1], f4[:,::1], f8[::1], f8[::1], f8[:,:,::1])')
def view(smooth: Any, near: Any, u: Any, v: Any, motion: Any) -> Any:
    """Return what a view shows; arguments as :func:`plain_view`."""
    height, width = smooth.shape
    spline = _down(_down(smooth))  # as high and wide as the crop again, turned over twice
    samples = len(u)
    patch, outline = np.empty(samples), np.zeros(samples)
    rows = len(motion)
    change, alone = np.empty((rows, samples)), np.empty(((rows + 2) // 3, samples))
    wu, wv = np.empty(4), np.empty(4)
    mean = 0.0
    for g in range(samples):
        j, i = int(np.floor(u[g])), int(np.floor(v[g]))
        for w, t in ((wu, u[g] - j), (wv, v[g] - i)):
            r = 1 - t
            w[0] = r * r * r / 6
            w[1] = (4 - 6 * t * t + 3 * t * t * t) / 6
            w[2] = (4 - 6 * r * r + 3 * r * r * r) / 6
            w[3] = t * t * t / 6
        value = 0.0
        if 1 <= i < height - 2 and 1 <= j < width - 2:
            for a in range(4):
                row = 0.0
                for b in range(4):
                    row += wu[b] * spline[i + a - 1, j + b - 1]
                value += wv[a] * row
        else:  # what lies outside repeats the border
            for a in range(4):
                k, row = min(max(i + a - 1, 0), height - 1), 0.0
                for b in range(4):
                    row += wu[b] * spline[k, min(max(j + b - 1, 0), width - 1)]
                value += wv[a] * row
        patch[g] = value
        mean += value
    mean /= samples
    square = 0.0
    for g in range(samples):
        patch[g] -= mean
        square += patch[g] * patch[g]
    scale = max(np.sqrt(square / samples), _LEAST_SCALE)
    for g in range(samples):
        patch[g] /= scale
        x, y = min(max(u[g], 0.0), width - 1.0), min(max(v[g], 0.0), height - 1.0)
        j, i = min(int(np.floor(x)), width - 2), min(int(np.floor(y)), height - 2)
        p, q = x - j, y - i
        by_u = by_v = edge = 0.0
        for a in range(2):
            for b in range(2):
                weight = (q if a else 1 - q) * (p if b else 1 - p)
                across = _slope_across(smooth, i + a, j + b)
                down = _slope_down(smooth, i + a, j + b)
                by_u += weight * across
                by_v += weight * down
                if near.size:
                    edge += weight * np.sqrt(across * across + down * down) * near[i + a, j + b]
        outline[g] = edge
        for c in range(rows):
            change[c, g] = (motion[c, g, 0] * by_u + motion[c, g, 1] * by_v) / scale
        for c in range(len(alone)):
            alone[c, g] = change[3 * c, g]
    for c in range(rows):
        _settle(change[c], patch)
    if near.size:
        _settle(outline, patch)
        size = 0.0
        for g in range(samples):
            size += outline[g] * outline[g]
        size = max(np.sqrt(size), _LEAST_OUTLINE)
        for g in range(samples):
            outline[g] /= size
        for c in range(rows):
            along = 0.0
            for g in range(samples):
                along += change[c, g] * outline[g]
            for g in range(samples):
                change[c, g] -= along * outline[g]
    return patch, change, alone, outline
