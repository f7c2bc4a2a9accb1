# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels of the detector: correlation, shifts, mirror symmetry and edges of small patches."""
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from .pyramid import Patches
from ..core.compiled import inlined, kernel
from ..vision.box_sums import window_sums

Floats = NDArray[np.float64]

LEAST_VARIANCE = 1.0  # squared grey levels; patches with less are noise and do not correlate
BAND = 3  # width of an edge in columns
_OFF_AXIS = 2  # greatest asymmetry of an edge and its mirror image, in samples
_TINY = 1e-6  # squared grey levels; avoids a division by zero where there is no edge


def plain_level(values: Patches, mask: NDArray[np.bool_]) -> Patches:
    """
    Return rows minus their means, because variation from row to row does not depend on depth.

    :param values: (n, rows, w).
    :param mask: (n, w) columns that count; the others become 0.
    """
    weight = mask[:, None, :].astype(np.float32)
    mean = (values * weight).sum(axis=2, keepdims=True) / weight.sum(axis=2, keepdims=True)
    return np.asarray((values - mean) * weight)


def plain_correlate(a: Patches, b: Patches) -> Floats:
    """Return the correlations (n,) of patches (n, rows, w) of zero mean; 0 without contrast."""
    mixed, of_a, of_b = (np.einsum('nrw,nrw->n', p, q, dtype=np.float64)
                         for p, q in ((a, b), (a, a), (b, b)))
    floor = LEAST_VARIANCE * np.maximum(np.count_nonzero(a.any(axis=1), axis=1), 1) * a.shape[1]
    return np.asarray(mixed / np.sqrt(np.maximum(of_a, floor) * np.maximum(of_b, floor)))


def cut(values: Patches, start: NDArray[np.int64], width: int) -> Patches:
    """Return columns ``start`` (n,) to ``start + width`` of patches (n, rows, w)."""
    columns: NDArray[Any] = start[:, None] + np.arange(width)
    return np.take_along_axis(values, columns[:, None, :], axis=2)


def plain_shifted(left: Patches, right: Patches, start: NDArray[np.int64],
                  mask: NDArray[np.bool_], most: int) -> Floats:
    """
    Return the correlations (2 most + 1, n) of windows with shifted windows.

    :param left: (n, rows, w).
    :param right: (n, rows, w).
    :param start: (n,) first columns of the windows.
    :param mask: (n, width) columns of a window that count.
    :param most: greatest shift either way, in columns.
    """
    width = mask.shape[1]
    mine = plain_level(cut(left, start, width), mask)
    return np.stack([plain_correlate(mine, plain_level(cut(right, start + k, width), mask))
                     for k in range(-most, most + 1)])


@inlined
def _means(values, first, mask, out):  # type: ignore
    """Write the means of the rows of a window over its masked columns into an array."""
    for r in range(values.shape[0]):
        total, count = 0.0, 0
        for c in range(len(mask)):
            if mask[c]:
                total += values[r, first + c]
                count += 1
        out[r] = total / count if count else np.nan


@inlined
def _columns(values, first, mask, mean):  # type: ignore
    """Return the number of columns of a window that differ from the means of its rows."""
    columns = 0
    for c in range(len(mask)):
        if mask[c]:
            for r in range(values.shape[0]):
                if values[r, first + c] != mean[r]:
                    columns += 1
                    break
    return max(columns, 1)


@kernel(plain_shifted, '(f4[:,:,::1], f4[:,:,::1], i8[::1], b1[:,::1], i8)')
def shifted(left: Any, right: Any, start: Any, mask: Any, most: Any) -> Any:
    """Return the correlations; arguments are those of :func:`plain_shifted`."""
    n, rows, _ = left.shape
    width = mask.shape[1]
    out = np.empty((2 * most + 1, n))
    mean, other = np.empty(rows), np.empty(rows)
    for i in range(n):
        first = start[i]
        _means(left[i], first, mask[i], mean)
        floor = LEAST_VARIANCE * rows * _columns(left[i], first, mask[i], mean)
        of_a = 0.0
        for r in range(rows):
            for c in range(width):
                if mask[i, c]:
                    of_a += (left[i, r, first + c] - mean[r]) ** 2
        for k in range(2 * most + 1):
            there = first + k - most
            _means(right[i], there, mask[i], other)
            mixed = of_b = 0.0
            for r in range(rows):
                for c in range(width):
                    if mask[i, c]:
                        b = right[i, r, there + c] - other[r]
                        mixed += (left[i, r, first + c] - mean[r]) * b
                        of_b += b * b
            out[k, i] = mixed / np.sqrt(max(of_a, floor) * max(of_b, floor))
    return out


def plain_symmetry(values: Patches, mask: NDArray[np.bool_]) -> Floats:
    """
    Return the correlations (n,) of windows (n, rows, w) with their mirror images.

    :param mask: (n, w) columns that count; the mask is symmetric.
    """
    level = plain_level(values, mask)
    return plain_correlate(level, level[:, :, ::-1])


@kernel(plain_symmetry, '(f4[:,:,::1], b1[:,::1])')
def symmetry(values: Any, mask: Any) -> Any:
    """Return the correlations; arguments are those of :func:`plain_symmetry`."""
    n, rows, width = values.shape
    out, mean = np.empty(n), np.empty(rows)
    for i in range(n):
        _means(values[i], 0, mask[i], mean)
        floor = LEAST_VARIANCE * rows * _columns(values[i], 0, mask[i], mean)
        mixed = of_a = 0.0
        for r in range(rows):
            for c in range(width):
                if mask[i, c]:
                    a = values[i, r, c] - mean[r]
                    mixed += a * (values[i, r, width - 1 - c] - mean[r])
                    of_a += a * a
        out[i] = mixed / max(of_a, floor)
    return out


def plain_mirrored(values: Patches, width: int) -> tuple[Floats, Floats]:
    """
    Return the product of each window with its mirror image, with the means of rows removed.

    :param values: (n, rows, w + k).
    :param width: width w of the windows, odd.
    :return: (n, k + 1) the sums of products, and the same for perfectly symmetric windows.
    """
    every = sliding_window_view(values, width, axis=2)  # (n, rows, windows, width)
    half = width // 2
    front, back = every[..., :half], every[..., :half:-1]
    mixed = 2 * np.einsum('nrwk,nrwk->nw', front, back) + np.einsum(
        'nrw,nrw->nw', every[..., half], every[..., half])
    mean = (window_sums(values, width) ** 2).sum(axis=1) / width
    square = window_sums((values * values).sum(axis=1, keepdims=True), width)[:, 0]
    floor = LEAST_VARIANCE * width * values.shape[1]
    return np.asarray(mixed - mean, np.float64), np.maximum(square - mean, floor)


@kernel(plain_mirrored, '(f4[:,:,::1], i8)')
def mirrored(values: Any, width: Any) -> Any:
    """Return the sums of products; arguments are those of :func:`plain_mirrored`."""
    n, rows, columns = values.shape
    windows, half = columns - width + 1, width // 2
    products, most = np.zeros((n, windows)), np.zeros((n, windows))
    floor = LEAST_VARIANCE * width * rows
    for i in range(n):
        for k in range(windows):
            mixed = mean = square = 0.0
            for r in range(rows):
                total = 0.0
                for c in range(half):
                    a = np.float64(values[i, r, k + c])
                    b = np.float64(values[i, r, k + width - 1 - c])
                    mixed += 2 * a * b
                    total += a + b
                    square += a * a + b * b
                middle = np.float64(values[i, r, k + half])
                mixed += middle * middle
                square += middle * middle
                total += middle
                mean += total * total
            mean /= width
            products[i, k] = mixed - mean
            most[i, k] = max(square - mean, floor)
    return products, most


def plain_edges(left: Patches, right: Patches) -> tuple[Floats, Floats, Floats]:
    """
    Return similarity and strength of the edges in each column, from the axis outwards.

    :param left: (n, rows, 2 half + 1) windows of the left view.
    :param right: the same of the right view, already shifted to agree.
    :return: (n, half + 1) correlation of edges with their mirror images; correlation of the edges
        of both views; root mean square of the weaker of an edge and its mirror image.
    """
    half, rows = left.shape[2] // 2, left.shape[1]
    views = [np.gradient(v, axis=2) for v in (left, right)]
    plus = [v[:, :, half:] for v in views]  # outwards from the axis
    minus = [-v[:, :, half::-1] for v in views]
    of_plus, of_minus = (_band(a, a) / 2 + _band(b, b) / 2 for a, b in (plus, minus))
    same = (_band(*plus) + _band(*minus)) / (of_plus + of_minus + _TINY)
    alike = np.full(same.shape, -1.0)
    for k in range(-_OFF_AXIS, _OFF_AXIS + 1):
        mixed = np.mean([_band(a, np.roll(b, k, axis=2)) for a, b in zip(plus, minus)], axis=0)
        alike = np.maximum(alike, mixed / np.sqrt(of_plus * np.roll(of_minus, k, axis=1) + _TINY))
    return alike, same, np.sqrt(np.minimum(of_plus, of_minus) / (rows * BAND))


def _band(a: Patches, b: Patches) -> Floats:
    """Return sums (n, k) of products of (n, rows, k) over the rows and three columns."""
    products = np.einsum('nrk,nrk->nk', a, b).astype(np.float64)
    out = products.copy()
    out[:, 1:] += products[:, :-1]
    out[:, :-1] += products[:, 1:]
    return np.asarray(out)


@inlined
def _bands(a, b, shift, out):  # type: ignore
    """Write sums over rows and columns of products of a and circularly shifted b into an array."""
    count = a.shape[1]
    for k in range(count):
        out[k] = 0.0
    for k in range(count):
        product = 0.0
        for r in range(a.shape[0]):
            product += a[r, k] * b[r, (k - shift) % count]
        for c in range(max(k - 1, 0), min(k + 2, count)):
            out[c] += product


@kernel(plain_edges, '(f4[:,:,::1], f4[:,:,::1])')
def edges(left: Any, right: Any) -> Any:
    """Return similarity and strength of edges; arguments are those of :func:`plain_edges`."""
    n, rows, width = left.shape
    half = width // 2
    count = half + 1
    alike, same, weaker = (np.empty((n, count)), np.empty((n, count)), np.empty((n, count)))
    plus, minus = np.empty((2, rows, count)), np.empty((2, rows, count))
    one, other = np.empty(count), np.empty(count)
    of_plus, of_minus = np.empty(count), np.empty(count)
    for i in range(n):
        for v in range(2):
            values = left[i] if v == 0 else right[i]
            for r in range(rows):
                for k in range(count):
                    a, b = half + k - 1, min(half + k + 1, width - 1)
                    plus[v, r, k] = (values[r, b] - values[r, a]) / (b - a)
                    a, b = max(half - k - 1, 0), half - k + 1
                    minus[v, r, k] = (values[r, a] - values[r, b]) / (b - a)
        _bands(plus[0], plus[0], 0, one)
        _bands(plus[1], plus[1], 0, other)
        for k in range(count):
            of_plus[k] = (one[k] + other[k]) / 2
        _bands(minus[0], minus[0], 0, one)
        _bands(minus[1], minus[1], 0, other)
        for k in range(count):
            of_minus[k] = (one[k] + other[k]) / 2
        _bands(plus[0], plus[1], 0, one)
        _bands(minus[0], minus[1], 0, other)
        for k in range(count):
            same[i, k] = (one[k] + other[k]) / (of_plus[k] + of_minus[k] + _TINY)
            alike[i, k] = -1.0
            weaker[i, k] = np.sqrt(min(of_plus[k], of_minus[k]) / (rows * BAND))
        for shift in range(-_OFF_AXIS, _OFF_AXIS + 1):
            _bands(plus[0], minus[0], shift, one)
            _bands(plus[1], minus[1], shift, other)
            for k in range(count):
                mixed = (one[k] + other[k]) / 2
                size = np.sqrt(of_plus[k] * of_minus[(k - shift) % count] + _TINY)
                alike[i, k] = max(alike[i, k], mixed / size)
    return alike, same, weaker
