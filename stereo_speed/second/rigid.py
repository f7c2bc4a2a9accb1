# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The places of a rigid body in each pair, from its corners in both views of several pairs.

The unknowns are the place of the body in each pair (along the path, to its left, above it) and
the place of each corner on the body; the body turns with the path.  The measurements are the
corners' rays.  All unknowns are solved together by Gauss-Newton with the corners eliminated first
(B. Triggs et al., "Bundle adjustment - a modern synthesis", 2000, section 6.1).  Residuals have
Student's t distribution, so that corners on the background get little weight.

A corner is not always a fixed point of the body: on the outline of a round object, such as a
rider's helmet, it slides over the surface, and errors of the optical flow accumulate from pair to
pair.  In addition to the noise of its sightings, each corner therefore has a random walk, which is
the same in both views because they are matched anew in each pair.  A sliding corner then
determines the range by its disparity, but hardly by the growth of the body.

The path gives only the direction: ranges come from the baseline alone.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Sequence

import numpy as np
from numpy.typing import NDArray

from ..core.records import Array
from ..core.tracker_config import SecondConfig
from ..geometry.rig import StereoRig
from ..road.path import Path

_ROUNDS = 10  # most Gauss-Newton steps, in which outliers lose their weight
_CONVERGED_M = 1e-4  # step at which the solution has converged
_STEP_M = 0.05  # step for finite differences along the path
# Prior 1-sigmas of a corner on the front of a body: in depth, to the side and above its centre.
_BODY_STD_M = np.array([0.3, 2.0, 2.0])
# A corner stays behind if it spreads along the path by so many median spreads plus so much.
_STAYS_FACTOR, _STAYS_M = 3.0, 0.5
_NEGLIGIBLE = 1e-9  # weight of such a corner, which keeps all equations solvable
_MIXING = 5  # rounds of expectation maximisation
# Variances of a corner's slide from pair to pair, in those of a sighting; the evidence decides.
SLIDES = (0.0, 0.03, 0.3, 3.0)
_EXACT_M = 1e-4  # lower bound of the 1-sigma of a place
_MOST_SQUARED = 100_000  # limit of corners times squared sightings in a group, 10 MB per matrix


@dataclass(frozen=True, eq=False)
class Rays:
    """
    The corners of a pair as rays.

    :param rig: the rig as it stood.
    :param stamp_s: time of the left exposure, s.
    :param lag_s: time from the left to the right exposure, s.
    :param ids: (n,) ids of the corners.
    :param left: (n, 2) rays at depth 1, in the left camera's frame of the site.
    :param right: (n, 2) rays at depth 1, in the right camera's frame.
    :param crowding: see :class:`.points.Sighting`.
    """

    rig: StereoRig
    stamp_s: float
    lag_s: float
    ids: NDArray[np.int64]
    left: Array
    right: Array
    crowding: float

    def only(self, keep: NDArray[np.bool_]) -> Rays:
        """Return the selected corners."""
        return replace(self, ids=self.ids[keep], left=self.left[keep], right=self.right[keep])

    def finite(self) -> Rays:
        """Return the corners that have a ray in both views; lens models end at some radius."""
        return self.only(np.asarray(
            np.isfinite(np.column_stack([self.left, self.right])).all(axis=1)))


@dataclass(frozen=True, eq=False)
class Places:
    """
    The places of a body in all pairs.

    :param stamps_s: (n,) times of the pairs, s.
    :param place: (n, 3) places along the path, to its left and above it, m.
    :param covariance: (n, 3, n, 3) their joint covariance, m^2.
    """

    stamps_s: Array
    place: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class _Corners:
    """
    Every sighting of every corner.

    :param pair: (N,) number of the pair.
    :param corner: (N,) number of the corner, from 0.
    :param rays: (N, 4) left and right ray, at depth 1.
    :param share: (N,) independent share of the sighting among those in its pair.
    :param along: (N,) 1 if the corner moves with the body, else almost 0.
    """

    pair: NDArray[np.int64]
    corner: NDArray[np.int64]
    rays: Array
    share: Array
    along: Array

    @cached_property
    def groups(self) -> Sequence[_Group]:
        """Return all corners in groups of similar numbers of sightings, limited in memory."""
        counts = np.bincount(self.corner)
        order, first = np.argsort(-counts, kind='stable'), np.cumsum(counts) - counts
        by_corner = np.argsort(self.corner, kind='stable')
        pair, out = np.append(self.pair, self.pair.max() + 1), []
        while len(order):
            most = int(counts[order[0]])
            own, order = np.split(order, [max(1, _MOST_SQUARED // most ** 2)])
            seen = np.arange(most) < counts[own, None]
            rows = np.full(seen.shape, len(self.pair))
            rows[seen] = by_corner[(first[own, None] + np.arange(most))[seen]]
            out.append(_Group(own, rows, pair[rows], seen))
        return out


@dataclass(frozen=True, eq=False)
class _Group:
    """
    Corners that are processed together, padded to the same number of sightings.

    :param corner: (m,) numbers of the corners.
    :param rows: (m, n) indices of the sightings of each corner, by pair; N for padding.
    :param pair: (m, n) pairs of these sightings; one more than the last pair for padding.
    :param seen: (m, n) False for padding.
    """

    corner: NDArray[np.int64]
    rows: NDArray[np.int64]
    pair: NDArray[np.int64]
    seen: NDArray[np.bool_]

    @cached_property
    def walk(self) -> Array:
        """Return the covariance (m, n, n) of a random walk of unit variance per pair."""
        pairs_since = np.where(self.seen, self.pair - self.pair[:, :1], 0).astype(float)
        return np.asarray(np.minimum(pairs_since[:, :, None], pairs_since[:, None]))

    def of_each(self, values: Array, empty: float = 0.0) -> Array:
        """Return values (N, ...) of sightings by corner: (m, n, ...)."""
        filled = np.concatenate([values, np.full_like(values[:1], empty)])
        return np.asarray(filled[self.rows])

    def covariances(self, slide: Array, weight: Array) -> Array:
        """
        Return (m, n, n) covariances of the sums of both views, in variances of a sighting.

        A slide accumulates as a random walk that is the same in both views.  It is therefore
        contained in the sum of both views over the root of two, but not in their difference.

        :param slide: (m,) see :class:`_Noise`.
        :param weight: (N,) weights of the sightings.
        """
        sighting_variance = self.of_each(1 / weight, 1.0)
        return np.asarray(2 * slide[:, None, None] * self.walk
                          + sighting_variance[:, :, None] * np.eye(sighting_variance.shape[1]))


@dataclass(frozen=True, eq=False)
class _Noise:
    """
    The noise of the corners.

    :param variance: variance of a sighting in one view, at depth 1.
    :param slide: (m,) variance of each corner's slide from pair to pair, in units of ``variance``.
    :param weight: (N,) weights of the sightings.
    """

    variance: float
    slide: Array
    weight: Array


def places_of(sightings: Sequence[Rays], path: Path, config: SecondConfig) -> Places:
    """
    Return the places of a body in all pairs.

    :param sightings: two or more pairs, each of which shares a corner with another one.
    :param path: path of its lane.
    :param config: limits of the precision of matches, and the tails of the residuals.
    """
    corners = _stacked(sightings)
    stamps = np.array([pair.stamp_s for pair in sightings])
    place, body, corners = _first_guess(sightings, corners, path)
    floor = (config.match_std_px / float(sightings[0].rig.left.K[0, 0])) ** 2
    moving = float(corners.along.sum())
    freedom = max(4 * moving - place.size - body.size, moving, 1.0)
    weight = np.ones(len(corners.pair))
    for _ in range(_ROUNDS):
        residual, by_place, by_body = _residuals(sightings, corners, path, place, body)
        noise = _noise_of(corners, residual, weight, freedom, floor)
        weight = _weights(corners, noise, residual, config.tail_dof)
        noise = replace(noise, weight=weight * corners.share * corners.along)
        step, steps, covariance = _solved(corners, noise, residual, by_place, by_body, body)
        place, body = place + step, body + steps
        if np.abs(step).max() < _CONVERGED_M:
            break
    return Places(stamps, place, covariance + _shared_error(sightings, path, place, config))


def _stacked(sightings: Sequence[Rays]) -> _Corners:
    ids = np.concatenate([pair.ids for pair in sightings])
    counts = [len(pair.ids) for pair in sightings]
    return _Corners(
        pair=np.repeat(np.arange(len(sightings)), counts),
        corner=np.unique(ids, return_inverse=True)[1].reshape(-1),
        rays=np.concatenate([np.column_stack([pair.left, pair.right]) for pair in sightings]),
        share=1 / np.repeat([pair.crowding for pair in sightings], counts),
        along=np.ones(len(ids)))


def _first_guess(sightings: Sequence[Rays], corners: _Corners, path: Path
                 ) -> tuple[Array, Array, _Corners]:
    """
    Return initial places (n, 3), corners on the body (m, 3), and the corners with ``along`` set.

    The initial values are medians of triangulated points.  A corner that stays behind, as on the
    background, spreads much more along the path than the others.
    """
    points = np.concatenate([_triangulated(pair) for pair in sightings])
    s_m = path.arc_length(points)
    off = np.einsum('ij,ijk->ik', points - path.position(s_m), path.frame(s_m))
    along = np.column_stack([s_m, off[:, 1:]])
    place = np.stack([np.median(along[corners.pair == i], axis=0)
                      for i in range(len(sightings))])
    near = along - place[corners.pair]
    count = int(corners.corner.max()) + 1
    body = np.stack([np.median(near[corners.corner == k], axis=0) for k in range(count)])
    off = np.abs(near - body[corners.corner])[:, 0]
    spread = np.array([np.median(off[corners.corner == k]) for k in range(count)])
    stays = spread > _STAYS_M + _STAYS_FACTOR * float(np.median(spread))
    along = np.where(stays[corners.corner], _NEGLIGIBLE, 1.0)
    return place, np.clip(body, -_BODY_STD_M, _BODY_STD_M), replace(corners, along=along)


def _triangulated(pair: Rays) -> Array:
    """Return the points (n, 3) nearest to both rays of each corner, m."""
    left = np.column_stack([pair.left, np.ones(len(pair.left))])
    right = np.column_stack([pair.right, np.ones(len(pair.right))]) @ pair.rig.R
    centre = -pair.rig.R.T @ pair.rig.t
    normal = np.stack([left, -right], axis=-1)
    depths = np.linalg.pinv(normal) @ centre
    return depths[:, :1] * left


def _residuals(sightings: Sequence[Rays], corners: _Corners, path: Path, place: Array,
               body: Array) -> tuple[Array, Array, Array]:
    """
    Return residuals (N, 4), and their derivatives by place (N, 4, 3) and by corner (N, 4, 3).

    For the right view, the body is moved by its own speed to its place at the right exposure.
    """
    stamps = np.array([pair.stamp_s for pair in sightings])
    lags = np.array([pair.lag_s for pair in sightings])
    speed = np.gradient(place[:, 0], stamps)
    residual, by_place, by_body = [], [], []
    for right in (False, True):
        s_m = place[:, 0] + lags * speed if right else place[:, 0]
        frames, centres = path.frame(s_m), path.position(s_m)
        ahead = path.position(s_m + _STEP_M) + np.einsum(
            'nij,nj->ni', path.frame(s_m + _STEP_M)[:, :, 1:], place[:, 1:])
        centres = centres + np.einsum('nij,nj->ni', frames[:, :, 1:], place[:, 1:])
        axes = np.concatenate([((ahead - centres) / _STEP_M)[..., None], frames[:, :, 1:]], axis=2)
        points = centres[corners.pair] + np.einsum(
            'nij,nj->ni', frames[corners.pair], body[corners.corner])
        if right:
            rotations = np.stack([pair.rig.R for pair in sightings])
            points = np.einsum('nij,nj->ni', rotations[corners.pair], points) + np.stack(
                [pair.rig.t for pair in sightings])[corners.pair]
            axes, frames = rotations @ axes, rotations @ frames
        depth = np.maximum(points[:, 2:], 1e-3)
        xy = points[:, :2] / depth
        project = np.zeros((len(points), 2, 3))
        project[:, 0, 0] = project[:, 1, 1] = 1 / depth[:, 0]
        project[:, :, 2] = -xy / depth
        residual.append(corners.rays[:, 2:] - xy if right else corners.rays[:, :2] - xy)
        by_place.append(project @ axes[corners.pair])
        by_body.append(project @ frames[corners.pair])
    return (np.concatenate(residual, axis=1), np.concatenate(by_place, axis=1),
            np.concatenate(by_body, axis=1))


def _noise_of(corners: _Corners, residual: Array, weight: Array, freedom: float, floor: float
              ) -> _Noise:
    """
    Return the noise estimated from the residuals (N, 4).

    The slides of corners are a mixture: each corner gets the most probable slide, given its own
    residuals and the share of corners with that slide.

    :param weight: (N,) weights of the sightings by Student's tails.
    :param freedom: degrees of freedom of the residuals.
    :param floor: least variance, at depth 1.
    """
    count = int(corners.corner.max()) + 1
    weight = weight * corners.along
    sums, differences = _sum_and_difference(residual)
    volumes, squares = np.empty((len(SLIDES), count)), np.empty((len(SLIDES), count))
    for group in corners.groups:
        group_sums = group.of_each(sums)
        difference_squares = group.of_each(weight[:, None] * differences ** 2).sum(axis=(1, 2))
        for k, slide in enumerate(SLIDES):
            roots = np.linalg.cholesky(
                group.covariances(np.full(len(group.corner), slide), weight))
            volumes[k, group.corner] = 2 * np.log(
                np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
            squares[k, group.corner] = difference_squares + np.sum(
                np.linalg.solve(roots, group_sums) ** 2, axis=(1, 2))
    shares = np.full(len(SLIDES), 1 / len(SLIDES))
    responsibilities = np.full_like(squares, 1 / len(SLIDES))
    for _ in range(_MIXING):
        variance = max(float(np.sum(responsibilities * squares)) / freedom, floor)
        logs = np.log(shares)[:, None] - volumes - 0.5 * squares / variance
        responsibilities = np.exp(logs - logs.max(axis=0))
        responsibilities /= responsibilities.sum(axis=0)
        shares = np.maximum(responsibilities.mean(axis=1), 1e-6)
    return _Noise(variance, np.array(SLIDES)[np.argmax(responsibilities, axis=0)], weight)


def _weights(corners: _Corners, noise: _Noise, residual: Array, dof: float) -> Array:
    """
    Return the weights (N,) of the sightings by Student's tails.

    This is one step of expectation maximisation.  The weight of a sighting follows from its
    unweighted residual after its corner's slide is subtracted, as estimated from all sightings of
    the corner with their current weights.
    """
    sums, differences = _sum_and_difference(residual)
    square = np.sum(differences ** 2, axis=1) / noise.variance
    for group in corners.groups:
        slide = noise.slide[group.corner]
        walk = 2 * slide[:, None, None] * group.walk
        gain = np.linalg.solve(group.covariances(slide, noise.weight), walk)
        own = group.of_each(sums)
        off = own - gain.transpose(0, 2, 1) @ own
        remaining = np.diagonal(walk - walk @ gain, axis1=1, axis2=2)
        square[group.rows[group.seen]] += (
            np.sum(off ** 2, axis=2) / noise.variance + 2 * remaining)[group.seen]
    return np.asarray((dof + 4) / (dof + square))


def _sum_and_difference(views: Array) -> tuple[Array, Array]:
    """Return sum and difference (N, 2, ...) of both views (N, 4, ...), with their variance."""
    left, right = views[:, :2] / np.sqrt(2), views[:, 2:] / np.sqrt(2)
    return left + right, left - right


def _solved(corners: _Corners, noise: _Noise, residual: Array, by_place: Array, by_body: Array,
            body: Array) -> tuple[Array, Array, Array]:
    """
    Return the steps of places (n, 3) and corners (m, 3), and the places' covariance.

    The corners are eliminated from the normal equations, group by group.
    """
    count = int(corners.pair.max()) + 1
    # The last block takes the padding, which adds nothing.
    reduced, right = np.zeros((3 * count + 3, 3 * count + 3)), np.zeros(3 * count + 3)
    slopes = _sum_and_difference(
        np.concatenate([by_place, by_body, residual[..., None]], axis=2))
    kept = []
    for group in corners.groups:
        places, across, toward, inner, h = _normals(group, noise, slopes, body)
        solved = across @ inner
        places -= solved @ across.transpose(0, 2, 1)
        toward -= (solved @ h[..., None])[..., 0]
        at = (3 * group.pair[:, :, None] + np.arange(3)).reshape(len(group.pair), -1)
        for where, own, own_right in zip(at, places, toward):
            reduced[where[:, None], where] += own
            right[where] += own_right
        kept.append((group.corner, at, across, inner, h))
    covariance = np.asarray(np.linalg.pinv(reduced[:-3, :-3], hermitian=True), dtype=float)
    step, steps = np.append(covariance @ right[:-3], np.zeros(3)), np.empty_like(body)
    for corner, at, across, inner, h in kept:
        rest = h - np.einsum('mak,ma->mk', across, step[at])
        steps[corner] = np.einsum('mkl,ml->mk', inner, rest)
    return step[:-3].reshape(-1, 3), steps, covariance.reshape(count, 3, count, 3)


def _normals(group: _Group, noise: _Noise, slopes: tuple[Array, Array], body: Array
             ) -> tuple[Array, Array, Array, Array, Array]:
    """
    Return the normal equations of corners that were seen in n pairs.

    They are the blocks of the places in these pairs (m, 3 n, 3 n), the blocks between places and
    corners (m, 3 n, 3) and the right sides of the places (m, 3 n); then the inverse blocks of the
    corners (m, 3, 3) and their right sides (m, 3).

    :param slopes: sums and differences of both views (N, 2, 7): derivatives by place and by
        corner, and residuals.
    """
    sums, differences = (group.of_each(one) for one in slopes)
    inverse = np.linalg.inv(noise.variance * group.covariances(
        noise.slide[group.corner], noise.weight))
    information = group.of_each(noise.weight / noise.variance)
    many, most = group.rows.shape
    by_place = sums[..., :3].transpose(0, 1, 3, 2).reshape(many, 3 * most, 2)
    places = (by_place @ by_place.transpose(0, 2, 1)).reshape(many, most, 3, most, 3)
    places *= inverse[:, :, None, :, None]
    # Information of each sighting by the difference, then that of all by the correlated sums.
    each = information[:, :, None, None] * (differences.transpose(0, 1, 3, 2) @ differences)
    at = np.arange(most)
    places[:, at, :, at] += each[:, :, :3, :3].transpose(1, 0, 2, 3)
    known = (inverse @ sums[..., 3:].reshape(many, most, 8)).reshape(many, most, 2, 4)
    rows = each[..., 3:] + sums.transpose(0, 1, 3, 2) @ known
    bodies = rows[:, :, 3:].sum(axis=1)
    inner = np.linalg.inv(bodies[:, :3, :3] + np.diag(1 / _BODY_STD_M ** 2))
    h = bodies[:, :3, 3] - body[group.corner] / _BODY_STD_M ** 2
    return (places.reshape(many, 3 * most, -1), rows[:, :, :3, :3].reshape(many, -1, 3),
            rows[:, :, :3, 3].reshape(many, -1), inner, h)


def _shared_error(sightings: Sequence[Rays], path: Path, place: Array, config: SecondConfig
                  ) -> Array:
    """Return the covariance (n, 3, n, 3) by the matching error that a pair's corners share."""
    out = np.zeros((len(place), 3, len(place), 3))
    for i, (pair, at) in enumerate(zip(sightings, place)):
        s_m = np.array(at[0])
        frame = path.frame(s_m)
        point = path.position(s_m) + frame[:, 1:] @ at[1:]
        focal_px, range_m = float(pair.rig.left.K[0, 0]), float(point[2])
        error_m = config.match_floor_px * range_m / (focal_px * pair.rig.baseline_m) * point
        shift = frame.T @ error_m
        out[i, :, i] = np.outer(shift, shift) + _EXACT_M ** 2 * np.eye(3)
    return out
