# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The sums over grey values that make up the photometric normal equations.

Each is a kernel: a loop that is compiled where numba is installed, beside the same in plain
numpy, which is easier to read.
"""
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.compiled import inlined, kernel
from ..core.records import Array
from ..estimation.student import student_weights

_LEAST_VARIANCE = 1e-4  # of residuals, relative to a patch; identical patches prove little
_ROUNDS = 3  # iterations of texture, gains and weights, which depend on each other
_STUDENT_ROUNDS = 3  # as in student_weights
_LEAST_MOTION = 1e-9  # information added, 1/m^2, for patches without contrast
_LEAST_SHARE = 1e-9  # share of the information added, for motions that look alike
_LEAST_BLUR = 1e-9  # change by blur of a patch without contrast
_LEAST_SIZE = 1e-3  # singular value below which the outlines of both views count as parallel


class TemporalTerms(NamedTuple):
    """
    Agreement of n observations with their common texture, which is eliminated.

    :param shared: (3 n, G) factor whose product with its transpose is the information that is
        lost to the unknown texture.
    :param mixed: (3 n, G) information between poses and the relief of each sample.
    :param relief: (G,) information of the relief of each sample.
    :param relief_right: (G,) information times measurement of the relief of each sample.
    :param blocks: (n, 3, 3) information of each pose.
    :param right: (3 n,) information times measurement of the poses.
    """

    shared: Array
    mixed: Array
    relief: Array
    relief_right: Array
    blocks: Array
    right: Array


def plain_temporal(rows: NDArray[np.int64], patches: Array, jacobian: Array, by_relief: Array,
                   outlines: Array, glare: Array, by_blur: Array, relief: Array, pixels: Array,
                   shift_px: Array, dof: float, independent: float, floor_px: float,
                   glare_floor_px: float) -> TemporalTerms:
    """
    Return the terms of :func:`temporal`, in plain numpy.

    :param rows: (n,) rows of the observations in tables of k.
    :param patches: (k, 2, G); instead of two there may be any number of views.
    :param jacobian: (k, 2, 3, G) derivatives of the patches by the pose, 1/m.
    :param by_relief: (k, 2, G) derivatives of the patches by the relief of each sample, 1/m.
    :param outlines: (k, 2, G) change by moving outlines, of unit length, or 0.
    :param glare: (k, 2, G) share of each sample that lies in the glare of clipped areas.
    :param by_blur: (G,) change of the texture by blur; how much each observation is blurred,
        equally in its views, is unknown.
    :param relief: (k, G) relief that each observation was taken with, m.
    :param pixels: (n,) number of pixels that each counts with, 0 to leave it out.
    :param shift_px: (k,) motion of the front per metre of a, px/m.
    :param dof: degrees of freedom of the t distribution of the residuals.
    :param independent: share of the pixels whose noise is independent.
    :param floor_px: systematic error of matching, which does not average out over samples.
    :param glare_floor_px: the same in the glare of clipped areas.
    """
    patches, jacobian, by_relief = patches[rows], jacobian[rows], by_relief[rows]
    outlines, glare = outlines[rows], glare[rows]
    relief, shift_px = relief[rows], shift_px[rows]
    n, views, samples = patches.shape
    blur = by_blur - (outlines @ by_blur)[..., None] * outlines  # what outlines leave of it
    blur = blur / np.maximum(np.linalg.norm(blur, axis=(1, 2)), _LEAST_BLUR)[:, None, None]
    # The relief of a sample keeps its own information; it loses a share of one in G to blur.
    jacobian = jacobian - np.einsum('nvg,nvcg->nc', blur, jacobian)[:, None, :, None] \
        * blur[:, :, None]
    weights = np.ones_like(patches)
    for _ in range(_ROUNDS):
        share = pixels[:, None, None] * weights
        texture = (share * patches).sum(axis=(0, 1)) / share.sum(axis=(0, 1))
        residual = beside(
            patches.reshape(views * n, -1), texture, weights.reshape(views * n, -1))
        along = outlines.reshape(views * n, -1)
        residual = residual - np.einsum('ng,ng->n', residual, along)[:, None] * along
        along = blur.reshape(n, -1)
        residual = residual.reshape(n, -1)
        residual = residual - np.einsum('ng,ng->n', residual, along)[:, None] * along
        both, variance = student_weights(
            _settled(residual.reshape(patches.shape), jacobian, weights).reshape(n, -1),
            weights.reshape(n, -1), dof, _LEAST_VARIANCE)
        weights = both.reshape(patches.shape)
    w = (independent * pixels / samples / variance)[:, None, None] * weights
    # The glare of clipped areas keeps its size in pixels while the front grows.
    parts = [share * w for share in (1 - glare, glare)]
    per_px = [(part * np.square(jacobian[:, :, 1])).sum(axis=(1, 2), keepdims=True)
              / np.maximum(shift_px ** 2, 1e-9)[:, None, None] for part in parts]
    w = sum(part / (1 + floor ** 2 * of_part) for part, of_part, floor in zip(
        parts, per_px, (floor_px, glare_floor_px)))
    # residuals as they would be on a plane, to first order
    flat = residual.reshape(patches.shape) - by_relief * relief[:, None]
    total = w.sum(axis=(0, 1))
    flat = flat - (w * flat).sum(axis=(0, 1)) / total
    weighted, of_relief = w[:, :, None] * jacobian, w * by_relief
    summed, all_relief = weighted.sum(axis=1).reshape(3 * n, -1), of_relief.sum(axis=(0, 1))
    return TemporalTerms(
        shared=summed / np.sqrt(total),
        mixed=(weighted * by_relief[:, :, None]).sum(axis=1).reshape(3 * n, -1)
        - summed * (all_relief / total),
        relief=(of_relief * by_relief).sum(axis=(0, 1)) - all_relief ** 2 / total,
        relief_right=-(of_relief * flat).sum(axis=(0, 1)),
        blocks=(weighted @ jacobian.swapaxes(2, 3)).sum(axis=1),
        right=-(weighted @ flat[..., None]).sum(axis=1).ravel())


def _plain_temporal(*args: Any) -> tuple[Array, ...]:
    return tuple(plain_temporal(*args))


@inlined
def _brightness(weights, texture, patch):  # type: ignore
    """Return the gain of a patch against a texture, and the means of texture and patch."""
    one = of_t = of_p = tt = tp = 0.0
    for g in range(len(weights)):
        w, t, p = weights[g], texture[g], patch[g]
        one += w
        of_t += w * t
        of_p += w * p
        tt += w * t * t
        tp += w * t * p
    of_t /= one
    of_p /= one
    return (tp / one - of_t * of_p) / max(tt / one - of_t * of_t, 1e-12), of_t, of_p


@kernel(_plain_temporal, '(i8[::1], f8[:,:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,:,::1], '
        'f8[:,:,::1], f8[::1], f8[:,::1], f8[::1], f8[::1], f8, f8, f8, f8)')
def _temporal(rows, patches, jacobian, by_relief, outlines, glare, by_blur,  # type: ignore
              relief, pixels, shift_px, dof, independent, floor_px, glare_floor_px):
    n, views, samples = len(rows), patches.shape[1], patches.shape[2]
    blur, moves = np.empty((n, views, samples)), np.empty((n, views, 3, samples))
    for i in range(n):
        at, length = rows[i], 0.0
        for v in range(views):
            along = 0.0
            for g in range(samples):
                along += by_blur[g] * outlines[at, v, g]
            for g in range(samples):
                blur[i, v, g] = by_blur[g] - along * outlines[at, v, g]
                length += blur[i, v, g] ** 2
        length = max(np.sqrt(length), _LEAST_BLUR)
        for v in range(views):
            for g in range(samples):
                blur[i, v, g] /= length
        for c in range(3):
            along = 0.0
            for v in range(views):
                for g in range(samples):
                    along += blur[i, v, g] * jacobian[at, v, c, g]
            for v in range(views):
                for g in range(samples):
                    moves[i, v, c, g] = jacobian[at, v, c, g] - along * blur[i, v, g]
    weights = np.ones((n, views, samples))
    residual, still = np.zeros((n, views, samples)), np.zeros((views, samples))
    texture, total = np.zeros(samples), np.zeros(samples)
    variance = np.zeros(n)
    for _ in range(_ROUNDS):
        texture[:] = 0.0
        total[:] = 0.0
        for i in range(n):
            at = rows[i]
            if pixels[i] > 0:
                for v in range(views):
                    for g in range(samples):
                        share = pixels[i] * weights[i, v, g]
                        texture[g] += share * patches[at, v, g]
                        total[g] += share
        for g in range(samples):
            texture[g] /= total[g]
        for i in range(n):
            at = rows[i]
            if not pixels[i] > 0:
                continue
            for v in range(views):
                gain, of_t, of_p = _brightness(weights[i, v], texture, patches[at, v])
                along = length = 0.0
                for g in range(samples):
                    r = patches[at, v, g] - of_p - gain * (texture[g] - of_t)
                    residual[i, v, g] = r
                    along += r * outlines[at, v, g]
                    length += outlines[at, v, g] * outlines[at, v, g]
                if length > 0:
                    for g in range(samples):
                        residual[i, v, g] -= along * outlines[at, v, g]
            along = 0.0
            for v in range(views):
                for g in range(samples):
                    along += residual[i, v, g] * blur[i, v, g]
            for v in range(views):
                for g in range(samples):
                    residual[i, v, g] -= along * blur[i, v, g]
            a00 = a01 = a02 = a11 = a12 = a22 = b0 = b1 = b2 = 0.0
            for v in range(views):
                for g in range(samples):
                    w, r = weights[i, v, g], residual[i, v, g]
                    j0, j1 = moves[i, v, 0, g], moves[i, v, 1, g]
                    j2 = moves[i, v, 2, g]
                    a00 += w * j0 * j0
                    a01 += w * j0 * j1
                    a02 += w * j0 * j2
                    a11 += w * j1 * j1
                    a12 += w * j1 * j2
                    a22 += w * j2 * j2
                    b0 += w * j0 * r
                    b1 += w * j1 * r
                    b2 += w * j2 * r
            # the pose that explains most of the residual, by a Cholesky factor
            least = _LEAST_SHARE * (a00 + a11 + a22) + _LEAST_MOTION
            l00 = np.sqrt(a00 + least)
            l10, l20 = a01 / l00, a02 / l00
            l11 = np.sqrt(a11 + least - l10 * l10)
            l21 = (a12 - l20 * l10) / l11
            l22 = np.sqrt(a22 + least - l20 * l20 - l21 * l21)
            b0 /= l00
            b1 = (b1 - l10 * b0) / l11
            b2 = (b2 - l20 * b0 - l21 * b1) / (l22 * l22)
            b1 = (b1 - l21 * b2) / l11
            b0 = (b0 - l10 * b1 - l20 * b2) / l00
            spread = 0.0
            for v in range(views):
                for g in range(samples):
                    r = residual[i, v, g] - b0 * moves[i, v, 0, g] - (
                        b1 * moves[i, v, 1, g] + b2 * moves[i, v, 2, g])
                    still[v, g] = r * r
                    spread += weights[i, v, g] * r * r
            spread = max(spread / (views * samples), _LEAST_VARIANCE)
            for _ in range(_STUDENT_ROUNDS):
                inverse, again = 1 / spread, 0.0
                for v in range(views):
                    for g in range(samples):
                        square = still[v, g]
                        w = (dof + 1) / (dof + square * inverse)
                        weights[i, v, g] = w
                        again += w * square
                spread = max(again / (views * samples), _LEAST_VARIANCE)
            variance[i] = spread
    shared = np.zeros((3 * n, samples))
    mixed = np.zeros((3 * n, samples))
    of_relief, of_relief_2 = np.zeros(samples), np.zeros(samples)
    level, relief_right = np.zeros(samples), np.zeros(samples)
    blocks, right = np.zeros((n, 3, 3)), np.zeros(3 * n)
    total[:] = 0.0
    for i in range(n):
        at = rows[i]
        if not pixels[i] > 0:
            continue
        scale = independent * pixels[i] / samples / variance[i]
        per_px = glare_per_px = 0.0
        for v in range(views):
            for g in range(samples):
                information = scale * weights[i, v, g] * moves[i, v, 1, g] ** 2
                per_px += (1 - glare[at, v, g]) * information
                glare_per_px += glare[at, v, g] * information
        shift_2 = max(shift_px[at] ** 2, 1e-9)
        lowered = 1 / (1 + floor_px ** 2 * per_px / shift_2)
        glare_lowered = 1 / (1 + glare_floor_px ** 2 * glare_per_px / shift_2)
        for v in range(views):
            for g in range(samples):
                share = glare[at, v, g]
                w = scale * weights[i, v, g] * (
                    (1 - share) * lowered + share * glare_lowered)
                d = by_relief[at, v, g]
                flat = residual[i, v, g] - d * relief[at, g]
                weights[i, v, g] = w
                residual[i, v, g] = flat
                total[g] += w
                level[g] += w * flat
                of_relief[g] += w * d
                of_relief_2[g] += w * d * d
    for g in range(samples):
        level[g] /= total[g]
    for i in range(n):
        at = rows[i]
        if not pixels[i] > 0:
            continue
        for v in range(views):
            for c in range(3):
                to_right = 0.0
                for g in range(samples):
                    wj = weights[i, v, g] * moves[i, v, c, g]
                    shared[3 * i + c, g] += wj
                    mixed[3 * i + c, g] += wj * by_relief[at, v, g]
                    to_right += wj * (residual[i, v, g] - level[g])
                right[3 * i + c] -= to_right
                for d in range(c + 1):
                    block = 0.0
                    for g in range(samples):
                        block += (weights[i, v, g] * moves[i, v, c, g]
                                  * moves[i, v, d, g])
                    blocks[i, c, d] += block
            for g in range(samples):
                relief_right[g] -= (weights[i, v, g] * by_relief[at, v, g]
                                    * (residual[i, v, g] - level[g]))
        for c in range(3):
            for d in range(c):
                blocks[i, d, c] = blocks[i, c, d]
            for g in range(samples):
                mixed[3 * i + c, g] -= shared[3 * i + c, g] * of_relief[g] / total[g]
                shared[3 * i + c, g] /= np.sqrt(total[g])
    for g in range(samples):
        of_relief_2[g] -= of_relief[g] ** 2 / total[g]
    return shared, mixed, of_relief_2, relief_right, blocks, right


def temporal(rows: NDArray[np.int64], patches: Array, jacobian: Array, by_relief: Array,
             outlines: Array, glare: Array, by_blur: Array, relief: Array, pixels: Array,
             shift_px: Array, dof: float, independent: float, floor_px: float,
             glare_floor_px: float) -> TemporalTerms:
    """Return the agreement with the texture; arguments are those of :func:`plain_temporal`."""
    return TemporalTerms(*_temporal(
        rows, patches, jacobian, by_relief, outlines, glare, by_blur, relief, pixels, shift_px,
        dof, independent, floor_px, glare_floor_px))


class CrossTerms(NamedTuple):
    """
    Agreement of the two patches of one observation.

    :param block: (k, k) information of the pose, and of further unknowns if there are any.
    :param mixed: (k, G) information between these and the relief of each sample.
    :param relief: (G,) information of the relief of each sample.
    :param right: (k,) information times measurement of the pose and further unknowns.
    :param relief_right: (G,) information times measurement of the relief of each sample.
    """

    block: Array
    mixed: Array
    relief: Array
    right: Array
    relief_right: Array


def plain_cross(patches: Array, jacobian: Array, by_relief: Array, outlines: Array,
                relief: Array, pixels: float, dof: float, independent: float) -> CrossTerms:
    """
    Return the terms of :func:`cross`, in plain numpy.

    :param patches: (2, G) left and right patch.
    :param jacobian: (k, G) derivatives of the left minus the right patch by the pose, 1/m, and by
        further unknowns.
    :param by_relief: (G,) the same derivatives by the relief of each sample, 1/m.
    :param outlines: (2, G) change by moving outlines, of unit length, or 0.
    :param relief: (G,) relief that the observation was taken with, m.
    :param pixels: number of pixels that it counts with.
    :param dof: degrees of freedom of the t distribution of the residuals.
    :param independent: share of the pixels whose noise is independent.
    """
    left, right = patches
    size, basis = np.linalg.svd(outlines, full_matrices=False)[1:]
    basis = basis[size > _LEAST_SIZE]
    J = jacobian - (jacobian @ basis.T) @ basis
    weights = np.ones((1, len(left)))
    for _ in range(_ROUNDS):
        r = beside(left[None], right, weights)
        r = r - (r @ basis.T) @ basis
        weights, variance = student_weights(
            _still(r, J[0], weights), weights, dof, _LEAST_VARIANCE)
    w = independent * pixels / len(left) / variance * weights[0]
    # The residual as it would be on a plane, to first order.
    weighted = w * (r[0] - by_relief * relief)
    return CrossTerms(block=(w * J) @ J.T, mixed=w * J * by_relief,
                      relief=w * np.square(by_relief), right=-J @ weighted,
                      relief_right=-by_relief * weighted)


def _plain_cross(*args: Any) -> tuple[Array, ...]:
    return tuple(plain_cross(*args))


@kernel(_plain_cross, '(f8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8, f8, f8)')
def _cross(patches, jacobian, by_relief, outlines, relief, pixels,  # type: ignore
           dof, independent):
    samples = patches.shape[1]
    left, right = patches[0], patches[1]
    # singular vectors of the two rows, from the eigenvectors of their inner products
    basis, spans = np.zeros((2, samples)), 0
    a = b = c = 0.0
    for g in range(samples):
        a += outlines[0, g] * outlines[0, g]
        b += outlines[0, g] * outlines[1, g]
        c += outlines[1, g] * outlines[1, g]
    if a + c > 0:
        middle, half = (a + c) / 2, np.sqrt(((a - c) / 2) ** 2 + b * b)
        angle = 0.5 * np.arctan2(2 * b, a - c)
        for k in range(2):
            square = middle + half if k == 0 else middle - half
            x = np.cos(angle) if k == 0 else -np.sin(angle)
            y = np.sin(angle) if k == 0 else np.cos(angle)
            if square > _LEAST_SIZE ** 2:
                for g in range(samples):
                    basis[spans, g] = (x * outlines[0, g] + y * outlines[1, g]) / np.sqrt(square)
                spans += 1
    count = len(jacobian)
    J = np.empty((count, samples))
    for d in range(count):
        for g in range(samples):
            J[d, g] = jacobian[d, g]
        for k in range(spans):
            along = 0.0
            for g in range(samples):
                along += J[d, g] * basis[k, g]
            for g in range(samples):
                J[d, g] -= along * basis[k, g]
    weights, r, still = np.ones(samples), np.zeros(samples), np.empty(samples)
    variance = 1.0
    for _ in range(_ROUNDS):
        gain, of_t, of_p = _brightness(weights, right, left)
        for g in range(samples):
            r[g] = left[g] - of_p - gain * (right[g] - of_t)
        for k in range(spans):
            along = 0.0
            for g in range(samples):
                along += r[g] * basis[k, g]
            for g in range(samples):
                r[g] -= along * basis[k, g]
        along, square = 0.0, _LEAST_MOTION
        for g in range(samples):
            along += weights[g] * J[0, g] * r[g]
            square += weights[g] * J[0, g] * J[0, g]
        variance = 0.0
        for g in range(samples):
            still[g] = (r[g] - along / square * J[0, g]) ** 2
            variance += weights[g] * still[g]
        variance = max(variance / samples, _LEAST_VARIANCE)
        for _ in range(_STUDENT_ROUNDS):
            inverse, again = 1 / variance, 0.0
            for g in range(samples):
                square = still[g]
                w = (dof + 1) / (dof + square * inverse)
                weights[g] = w
                again += w * square
            variance = max(again / samples, _LEAST_VARIANCE)
    scale = independent * pixels / samples / variance
    block, mixed = np.zeros((count, count)), np.empty((count, samples))
    to_right = np.zeros(count)
    of_relief, relief_right = np.empty(samples), np.empty(samples)
    for g in range(samples):
        w, d = scale * weights[g], by_relief[g]
        flat = w * (r[g] - d * relief[g])
        weights[g], r[g] = w, flat
        of_relief[g] = w * d * d
        relief_right[g] = -d * flat
    for k in range(count):
        along = 0.0
        for g in range(samples):
            mixed[k, g] = weights[g] * J[k, g] * by_relief[g]
            along += J[k, g] * r[g]
        to_right[k] = -along
        for m in range(k + 1):
            both = 0.0
            for g in range(samples):
                both += weights[g] * J[k, g] * J[m, g]
            block[k, m] = block[m, k] = both
    return block, mixed, of_relief, to_right, relief_right


def cross(patches: Array, jacobian: Array, by_relief: Array, outlines: Array, relief: Array,
          pixels: float, dof: float, independent: float) -> CrossTerms:
    """Return the agreement of two patches; arguments are those of :func:`plain_cross`."""
    return CrossTerms(*_cross(patches, jacobian, by_relief, outlines, relief, pixels, dof,
                              independent))


def _settled(residual: Array, jacobian: Array, weights: Array) -> Array:
    """
    Return residuals (n, 2, G) minus the part that a change of pose explains.

    The reason is that of :func:`_still`.

    :param jacobian: (n, 2, 3, G) derivatives by the pose.
    :param weights: (n, 2, G) weights of the samples.
    """
    weighted = jacobian * weights[:, :, None]
    information = np.einsum('nvag,nvbg->nab', weighted, jacobian)
    least = _LEAST_SHARE * np.trace(information, axis1=1, axis2=2) + _LEAST_MOTION
    gradient = np.einsum('nvag,nvg->na', weighted, residual)
    moved = np.linalg.solve(information + least[:, None, None] * np.eye(3), gradient[..., None])
    return np.asarray(residual - (moved[:, None] * jacobian).sum(axis=2))


def _still(residual: Array, motion: Array, weights: Array) -> Array:
    """
    Return a residual (1, G) minus the part that a motion explains.

    A patch that is not yet in place has its largest residuals at edges, which determine the place.
    If these residuals counted as outliers, edges would lose their weight, and the patch would
    never move into place.

    :param motion: (G,) derivative by the motion.
    :param weights: (1, G) weights of the samples.
    """
    weighted = weights[0] * motion
    moved = residual @ weighted / (weighted @ motion + _LEAST_MOTION)
    return np.asarray(residual - moved[:, None] * motion)


def beside(patches: Array, texture: Array, weights: Array) -> Array:
    """
    Return patches (N, G) minus a texture (G,) with the gain and level that fit each best.

    :param weights: (N, G) weights of the samples, so that outliers do not affect gain and level.
    """
    share = weights / weights.sum(axis=1, keepdims=True)
    deviation = texture - (share @ texture)[:, None]
    patches = patches - (share * patches).sum(axis=1, keepdims=True)
    along = share * deviation
    gain = (along * patches).sum(axis=1) / np.maximum((along * deviation).sum(axis=1), 1e-12)
    return np.asarray(patches - gain[:, None] * deviation)
