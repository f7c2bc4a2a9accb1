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

_LEAST_SCALE = 0.01  # grey levels; lower contrast is rounding, which agrees in blank views
_LEAST_OUTLINE = 1e-9


def plain_points(positions: Array, frames: Array, beside: Array, on_vehicle: Array) -> Array:
    """
    Return points (N, M, 3) of a front for many poses.

    :param positions: (N, 3) positions on the path.
    :param frames: (N, 3, 3) frames of the path there.
    :param beside: (N, 2) offsets of each pose to the left and up, m.
    :param on_vehicle: (M, 3) coordinates ahead, to the left and above the front's centre, m.
    """
    offset = on_vehicle[None] + np.concatenate(
        [np.zeros((len(beside), 1)), beside], axis=1)[:, None]
    return np.asarray(positions[:, None] + offset @ np.swapaxes(frames, 1, 2))


@kernel(plain_points, '(f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1])')
def points(positions: Any, frames: Any, beside: Any, on_vehicle: Any) -> Any:
    """Return the points; arguments are those of :func:`plain_points`."""
    out = np.empty((len(positions), len(on_vehicle), 3))
    for i in range(len(positions)):
        for d in range(3):
            t, p, b = frames[i, d, 0], frames[i, d, 1], frames[i, d, 2]
            here = positions[i, d] + p * beside[i, 0] + b * beside[i, 1]
            for j in range(len(on_vehicle)):
                out[i, j, d] = (here + t * on_vehicle[j, 0] + p * on_vehicle[j, 1]
                                + b * on_vehicle[j, 2])
    return out


class Spread(NamedTuple):
    """
    Pixels and motion of the samples in both views, and the size of the front there.

    :param at: (2, 2, G) columns and rows of the samples, px.
    :param motion: (2, 6, G, 2) derivatives of the samples by s, a and b, px/m, followed by those
        of the left view minus those of the right one.
    :param centre: (2, 3, 2) means over the samples of the first three, px/m.
    :param bounds: (2, 2, 2) least and greatest pixel of the samples, px.
    :param apart: (2, 2) mean distance of neighbours, down and across, px.
    :param area: (2,) area of the quad of the corners, px^2.
    """

    at: Array
    motion: Array
    centre: Array
    bounds: Array
    apart: Array
    area: Array


def plain_spread(left: Array, right: Array, rows: int, columns: int, step_m: float
                 ) -> tuple[Array, ...]:
    """
    Return the fields of :class:`Spread`.

    :param left: (4, G + 4, 2) pixels of samples and corners in the left view, at a pose and one
        step further along each of its axes.
    :param right: (4, G + 4, 2) the same in the right view.
    :param rows: number of rows of the grid of samples.
    :param columns: number of columns of that grid.
    :param step_m: the step, m.
    """
    uv, samples = np.stack([left, right]), rows * columns
    motion = (uv[:, 1:, :samples] - uv[:, :1, :samples]) / step_m
    at, (x, y) = uv[:, 0, :samples], np.moveaxis(uv[:, 0, samples:], -1, 0)
    grid = at.reshape(2, rows, columns, 2)
    apart = np.stack([np.linalg.norm(np.diff(grid, axis=k), axis=-1).mean(axis=(1, 2))
                      for k in (1, 2)], axis=-1)
    area = np.abs(np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)) / 2
    parting = np.broadcast_to(motion[0] - motion[1], motion.shape)
    return (np.moveaxis(at, -1, 1), np.concatenate([motion, parting], axis=1),
            motion.mean(axis=2), np.stack([at.min(axis=1), at.max(axis=1)], axis=1), apart, area)


@kernel(plain_spread, '(f8[:,:,::1], f8[:,:,::1], i8, i8, f8)')
def spread(left: Any, right: Any, rows: Any, columns: Any, step_m: Any) -> Any:
    """Return the fields of :class:`Spread`; arguments are those of :func:`plain_spread`."""
    samples = rows * columns
    at, motion, centre = np.empty((2, 2, samples)), np.empty((2, 6, samples, 2)), np.zeros(
        (2, 3, 2))
    bounds, apart, area = np.empty((2, 2, 2)), np.zeros((2, 2)), np.zeros(2)
    for side in range(2):
        uv = left if side == 0 else right
        bounds[side, 0], bounds[side, 1] = np.inf, -np.inf
        for d in range(2):
            for g in range(samples):
                at[side, d, g] = uv[0, g, d]
                bounds[side, 0, d] = min(bounds[side, 0, d], uv[0, g, d])
                bounds[side, 1, d] = max(bounds[side, 1, d], uv[0, g, d])
        for c in range(3):
            for g in range(samples):
                for d in range(2):
                    slope = (uv[c + 1, g, d] - uv[0, g, d]) / step_m
                    motion[side, c, g, d] = slope
                    centre[side, c, d] += slope
            for d in range(2):
                centre[side, c, d] /= samples
        for i in range(rows):
            for j in range(columns):
                g = i * columns + j
                if i + 1 < rows:
                    h = g + columns
                    apart[side, 0] += np.hypot(uv[0, h, 0] - uv[0, g, 0],
                                               uv[0, h, 1] - uv[0, g, 1])
                if j + 1 < columns:
                    h = g + 1
                    apart[side, 1] += np.hypot(uv[0, h, 0] - uv[0, g, 0],
                                               uv[0, h, 1] - uv[0, g, 1])
        apart[side, 0] /= (rows - 1) * columns
        apart[side, 1] /= rows * (columns - 1)
        for k in range(4):
            a, b = samples + k, samples + (k + 1) % 4
            area[side] += uv[0, a, 0] * uv[0, b, 1] - uv[0, a, 1] * uv[0, b, 0]
        area[side] = abs(area[side]) / 2
    for c in range(3):
        for g in range(samples):
            for d in range(2):
                parting = motion[0, c, g, d] - motion[1, c, g, d]
                motion[0, 3 + c, g, d] = motion[1, 3 + c, g, d] = parting
    return at, motion, centre, bounds, apart, area


class Views(NamedTuple):
    """The fields of an ``Observation`` that come from the images, as documented there."""

    patches: Array
    jacobian: Array
    relief_jacobian: Array
    outlines: Array
    by_blur: Array
    apart_jacobian: Array
    apart_relief: Array


def plain_views(left: Patches, left_near: Patches, right: Patches, right_near: Patches,
                origins: Array, at: Array, motion: Array, apart: Array, gamma: float,
                dark: float) -> tuple[Array, ...]:
    """
    Return the fields of :class:`Views`.

    :param left: (h, w) crop of the left view, low-passed.
    :param left_near: (h, w) low-passed mask of its clipped areas; (0, 0) if there are none.
    :param right: as ``left``, of the right view.
    :param right_near: as ``left_near``, of the right view.
    :param origins: (2, 2) columns and rows of the images where the crops begin.
    :param at: (2, 2, G) as of :class:`Spread`.
    :param motion: (2, 6, G, 2) as of :class:`Spread`.
    :param apart: (2, 2) as of :class:`Spread`.
    :param gamma: grey levels are this root of the light.
    :param dark: grey level below which the root is taken to be no steeper.
    """
    seen = [plain_view(smooth, near, u - origin[0], v - origin[1], moves, steps, gamma, dark)
            for smooth, near, origin, (u, v), moves, steps in zip(
                (left, right), (left_near, right_near), origins, at, motion, apart)]
    patches, jacobian, alone, outlines, by_blur = (np.array(part) for part in zip(*seen))
    return (patches, jacobian[:, :3], alone[:, 0], outlines, by_blur,
            jacobian[:, 3:].mean(axis=0), alone[:, 1].mean(axis=0))


def plain_view(smooth: Patches, near: Patches, u: Array, v: Array, motion: Array, apart: Array,
               gamma: float, dark: float) -> tuple[Array, Array, Array, Array, Array]:
    """
    Return the patch of a view, its derivatives by pose and relief, and its other changes.

    :param smooth: (h, w) crop of the view, low-passed.
    :param near: (h, w) low-passed mask of its clipped areas; (0, 0) if there are none.
    :param u: (G,) columns of the samples in the crop.
    :param v: (G,) rows of the samples in the crop.
    :param motion: (3 k, G, 2) derivatives of the samples' pixels, px/m; numbers 0, 3, … are by s.
    :param apart: (2,) mean distance of neighbouring samples, down and across, px.
    :param gamma: as of :func:`plain_views`.
    :param dark: likewise.
    :return: (G,) the patch, (3 k, G) its derivatives, (k, G) those by s before the patch is
        normalised, (G,) its change when the outlines of clipped areas move outwards, (G,) its
        change by blur off clipped areas: that of the image when its light has the change of its
        Laplacian, in steps of the grid (the heat equation).
    """
    at, spline = np.stack([v, u]), ndimage.spline_filter(smooth, 3, np.float64)
    values = ndimage.map_coordinates(spline, at, order=3, mode='nearest', prefilter=False)
    scale = max(float(values.std()), _LEAST_SCALE)
    patch = (values - values.mean()) / scale
    slopes = [np.asarray(slope) for slope in np.gradient(smooth)]
    by_v, by_u = (_between(slope, at) / scale for slope in slopes)
    jacobian = motion[..., 0] * by_u + motion[..., 1] * by_v  # (3, G)
    change = normalised_change(jacobian, patch)
    bends = [ndimage.correlate1d(smooth, (1, -2, 1), axis, mode='nearest') for axis in (0, 1)]
    outwards = (gamma - 1) / np.maximum(smooth, dark)  # of edges, into what is dark
    laplacian = sum(_between(bend + outwards * np.square(slope), at) * step ** 2
                    for bend, slope, step in zip(bends, slopes, apart))
    # Light is blurred before it is clipped: near clipped areas, blur moves their outlines.
    unclipped = 1 - _between(near, at) if near.size else np.ones_like(patch)
    by_blur = normalised_change((unclipped * laplacian / scale)[None], patch)[0]
    if not near.size:
        return patch, change, jacobian[::3], np.zeros_like(patch), by_blur
    outline = normalised_change(_between(np.hypot(*slopes) * near, at)[None], patch)[0]
    outline = outline / max(float(np.linalg.norm(outline)), _LEAST_OUTLINE)
    return patch, without(change, outline), jacobian[::3], outline, by_blur


def _between(image: Patches, at: Array) -> Array:
    return np.asarray(ndimage.map_coordinates(
        image, at, np.float64, order=1, mode='nearest', prefilter=False))


def normalised_change(jacobian: Array, patches: Array) -> Array:
    """
    Return the derivatives of patches that are normalised to zero mean and unit variance.

    :param jacobian: (..., 3, G) derivatives before, divided by the standard deviation.
    :param patches: (..., G) normalised patches.
    :return: (..., 3, G), orthogonal to a constant and to the patch itself.
    """
    jacobian = jacobian - jacobian.mean(axis=-1, keepdims=True)
    along = jacobian @ patches[..., None] / patches.shape[-1]
    return np.asarray(jacobian - along * patches[..., None, :])


def without(change: Array, outline: Array) -> Array:
    """
    Return changes of patches (..., 3, G) without their components along moving outlines.

    :param outline: (..., G) of unit length, or 0.
    """
    return np.asarray(change - change @ outline[..., None] * outline[..., None, :])


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
def _bend_down(image, i, j):  # type: ignore
    """Return the second difference from row to row, one-sided at the edges."""
    a, b = max(i - 1, 0), min(i + 1, image.shape[0] - 1)
    return image[a, j] - 2 * image[i, j] + image[b, j]


@inlined
def _bend_across(image, i, j):  # type: ignore
    """Return the second difference from column to column, one-sided at the edges."""
    a, b = max(j - 1, 0), min(j + 1, image.shape[1] - 1)
    return image[i, a] - 2 * image[i, j] + image[i, b]


@inlined
def _settle(change, patch):  # type: ignore
    """Remove the components along a constant and along the patch from a row."""
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


@inlined
def _view(smooth, near, left, top, at, motion, apart, gamma, dark, patch,  # type: ignore
          outline, by_blur, change, alone):
    """Write the results of :func:`plain_view` for one view into the last five arrays."""
    height, width = smooth.shape
    spline = _down(_down(smooth))  # transposed twice, so again of the shape of the crop
    samples, rows = len(patch), len(motion)
    wu, wv = np.empty(4), np.empty(4)
    mean = 0.0
    for g in range(samples):
        x, y = at[0, g] - left, at[1, g] - top
        j, i = int(np.floor(x)), int(np.floor(y))
        for w, t in ((wu, x - j), (wv, y - i)):
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
        else:  # the border is repeated outside the crop
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
        x = min(max(at[0, g] - left, 0.0), width - 1.0)
        y = min(max(at[1, g] - top, 0.0), height - 1.0)
        j, i = min(int(np.floor(x)), width - 2), min(int(np.floor(y)), height - 2)
        p, q = x - j, y - i
        by_u = by_v = edge = laplacian = clipped = 0.0
        for a in range(2):
            for b in range(2):
                weight = (q if a else 1 - q) * (p if b else 1 - p)
                across = _slope_across(smooth, i + a, j + b)
                down = _slope_down(smooth, i + a, j + b)
                by_u += weight * across
                by_v += weight * down
                outwards = (gamma - 1) / max(smooth[i + a, j + b], dark)
                laplacian += weight * (
                    (_bend_down(smooth, i + a, j + b) + outwards * down * down) * apart[0] ** 2
                    + (_bend_across(smooth, i + a, j + b) + outwards * across * across)
                    * apart[1] ** 2)
                if near.size:
                    clipped += weight * near[i + a, j + b]
                    edge += weight * np.sqrt(across * across + down * down) * near[i + a, j + b]
        outline[g], by_blur[g] = edge, laplacian * (1 - clipped) / scale
        for c in range(rows):
            change[c, g] = (motion[c, g, 0] * by_u + motion[c, g, 1] * by_v) / scale
        for c in range(len(alone)):
            alone[c, g] = change[3 * c, g]
    for c in range(rows):
        _settle(change[c], patch)
    _settle(by_blur, patch)
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


@kernel(plain_views, '(f4[:,::1], f4[:,::1], f4[:,::1], f4[:,::1], f8[:,::1], f8[:,:,::1], '
        'f8[:,:,:,::1], f8[:,::1], f8, f8)')
def views(left, left_near, right, right_near, origins, at, motion, apart, gamma,  # type: ignore
          dark):
    """Return the fields of :class:`Views`; arguments are those of :func:`plain_views`."""
    samples = at.shape[2]
    patches, by_blur, outlines = (
        np.empty((2, samples)), np.empty((2, samples)), np.zeros((2, samples)))
    change, alone = np.empty((2, 6, samples)), np.empty((2, 2, samples))
    for side in range(2):
        smooth, near = (left, left_near) if side == 0 else (right, right_near)
        _view(smooth, near, origins[side, 0], origins[side, 1], at[side], motion[side],
              apart[side], gamma, dark, patches[side], outlines[side], by_blur[side],
              change[side], alone[side])
    jacobian, by_relief = np.empty((2, 3, samples)), np.empty((2, samples))
    parting, parting_relief = np.empty((3, samples)), np.empty(samples)
    for c in range(3):
        for g in range(samples):
            jacobian[0, c, g], jacobian[1, c, g] = change[0, c, g], change[1, c, g]
            parting[c, g] = 0.5 * (change[0, 3 + c, g] + change[1, 3 + c, g])
    for g in range(samples):
        by_relief[0, g], by_relief[1, g] = alone[0, 0, g], alone[1, 0, g]
        parting_relief[g] = 0.5 * (alone[0, 1, g] + alone[1, 1, g])
    return patches, jacobian, by_relief, outlines, by_blur, parting, parting_relief
