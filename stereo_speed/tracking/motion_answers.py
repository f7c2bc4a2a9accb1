# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The solution of a pass under each motion model, given the information of the images: a kernel.

In plain numpy each model is one system of normal equations, as ``motion_prior`` defines it.  The
loop solves the same in parts.  The equations of motion along the path, across it and above it are
set up once for all models that share them.  In each of these parts, the unknowns that images do
not observe are eliminated: speeds, accelerations and the errors of the path.  Only the poses
remain for each model.
"""
from __future__ import annotations

from typing import NamedTuple, Sequence

import numpy as np
from numpy.typing import NDArray

from .motion_prior import MotionModel, normal_equations, PassMotion, Processes
from ..core.compiled import inlined, kernel
from ..core.records import Array
from ..estimation.gaussian import condition, NormalEquations


class Answers(NamedTuple):
    """
    Answers of m motion models: poses, speeds and errors of the path of n observations.

    :param log_evidence: (m,) of the images, up to a constant that all models share.
    :param means: (m, 4 n + 3).
    :param covariances: (m, 4 n + 3, 4 n + 3), or empty if not requested.
    """

    log_evidence: Array
    means: Array
    covariances: Array


def answers(motion: PassMotion, times_s: Array, state: Array, models: Sequence[MotionModel],
            scatters: Sequence[int], H: Array, right: Array, *, covariances: bool = False
            ) -> Answers:
    """
    Return the answers of motion models to the equations of the images.

    :param motion: priors of a pass.
    :param times_s: (n,) stamps, s.
    :param state: (n, 4) s, a, b and speed to linearise at.
    :param scatters: (m,) index of the scatter of disparities, 0 to k - 1, that each model has.
    :param H: (k, 3 n, 3 n) information of the images about the poses, or (k, 4 n, 4 n) about the
        poses and then the speeds; one for each of k scatters of the disparities.
    :param right: (k, 3 n) or (k, 4 n) information times measurement.
    :param covariances: whether to return covariances.
    :raises numpy.linalg.LinAlgError: the equations cannot be solved.
    """
    begun = motion.beginning(len(times_s))
    table = np.array([[np.nan if m.speed_rate_std is None else m.speed_rate_std,
                       m.changes_lanes, m.ride_std_m] for m in models])
    solve = _answers if right.shape[1] == 3 * len(times_s) else plain_answers
    solved = Answers(*solve(
        H, right, begun.H, begun.g, begun.log_rows, times_s, state, table,
        np.array(scatters, dtype=np.int64), np.array(motion.processes), int(covariances)))
    if not np.isfinite(solved.log_evidence).all():
        raise np.linalg.LinAlgError('information matrix not positive definite')
    return solved


def plain_answers(H: Array, right: Array, begun: Array, begun_right: Array, log_rows: float,
                  times_s: Array, state: Array, models: Array, scatters: NDArray[np.int64],
                  processes: Array, covariances: int) -> tuple[Array, Array, Array]:
    """
    Return the answers, each from the normal equations of all unknowns.

    :param H: (k, 3 n, 3 n) information of the images about the poses, or (k, 4 n, 4 n).
    :param right: (k, 3 n) information times measurement, or (k, 4 n).
    :param begun: (5 n + 3, 5 n + 3) prior information about the beginning of the pass.
    :param begun_right: (5 n + 3,) information times measurement.
    :param log_rows: as that of ``NormalEquations``.
    :param times_s: (n,) stamps, s.
    :param state: (n, 4) s, a, b and speed to linearise at.
    :param models: (m, 3) random walk of the speed, NaN where that of the acceleration is used;
        whether lanes are changed; ride, m.
    :param scatters: (m,) index of the H and right that each model is combined with.
    :param processes: those of ``Processes``.
    :param covariances: whether to return covariances; else their array is empty.
    """
    start = NormalEquations(0)
    start.H, start.g, start.log_rows = begun, begun_right, log_rows
    steady = 4 * len(times_s) + 3
    kinds = [MotionModel(1.0, None if np.isnan(rate) else float(rate), bool(changes), float(ride))
             for rate, changes, ride in models]
    solved = [condition(prior, H[k], right[k], chain=True) for k, prior in zip(
        scatters, normal_equations(start, Processes(*processes), times_s, state, kinds))]
    return (np.array([one.log_evidence for one in solved]),
            np.array([one.mean[:steady] for one in solved]),
            np.array([one.covariance[:steady, :steady] for one in solved]) if covariances
            else np.zeros((0, 0, 0)))


@inlined
def _add_rows(equations, rows, covariance, band):  # type: ignore
    """
    Add rows with correlated errors to the first unknowns of equations.

    Rows and covariance are overwritten.

    :param band: number of entries left of the covariance's diagonal that can be nonzero.
    :return: logarithm of the determinant of the rows' information.
    """
    log_rows = 0.0
    for i in range(len(covariance)):
        first = max(i - band, 0)
        for j in range(first, i + 1):
            entry = covariance[i, j]
            for k in range(first, j):
                entry -= covariance[i, k] * covariance[j, k]
            covariance[i, j] = np.sqrt(entry) if j == i else entry / covariance[j, j]
        for j in range(first, i):
            for c in range(rows.shape[1]):
                rows[i, c] -= covariance[i, j] * rows[j, c]
        for c in range(rows.shape[1]):
            rows[i, c] /= covariance[i, i]
        log_rows -= 2 * np.log(covariance[i, i])
    columns = np.ascontiguousarray(rows.T)
    for i in range(len(columns)):
        for j in range(i + 1):
            both = 0.0
            for k in range(columns.shape[1]):
                both += columns[i, k] * columns[j, k]
            equations[i, j] += both
    return log_rows


@inlined
def _eliminate(equations, count):  # type: ignore
    """
    Eliminate the first unknowns of equations, in place; the last row is their right-hand side.

    Only lower triangles are used.  The columns of eliminated unknowns then hold their Cholesky
    factor.

    :return: logarithm of the determinant of the eliminated block.
    """
    size, log_det = len(equations), 0.0
    for j in range(count):
        pivot = equations[j, j]
        for k in range(j):
            pivot -= equations[j, k] * equations[j, k]
        pivot = np.sqrt(pivot)
        equations[j, j] = pivot
        log_det += 2 * np.log(pivot)
        # Four rows at once, so that each entry of row j is read once for all of them.
        whole = j + 1 + (size - j - 1) // 4 * 4
        for i in range(j + 1, whole, 4):
            p = q = r = s = 0.0
            for k in range(j):
                entry = equations[j, k]
                p += equations[i, k] * entry
                q += equations[i + 1, k] * entry
                r += equations[i + 2, k] * entry
                s += equations[i + 3, k] * entry
            equations[i, j] = (equations[i, j] - p) / pivot
            equations[i + 1, j] = (equations[i + 1, j] - q) / pivot
            equations[i + 2, j] = (equations[i + 2, j] - r) / pivot
            equations[i + 3, j] = (equations[i + 3, j] - s) / pivot
        for i in range(whole, size):
            p = 0.0
            for k in range(j):
                p += equations[i, k] * equations[j, k]
            equations[i, j] = (equations[i, j] - p) / pivot
    for i in range(count, size):
        for j in range(count, i + 1):
            p = 0.0
            for k in range(count):
                p += equations[i, k] * equations[j, k]
            equations[i, j] -= p
    return log_det


@inlined
def _inverse(factor, count):  # type: ignore
    """Return the inverse of the lower triangle of the first unknowns, (count, count)."""
    out = np.zeros((count, count))
    for i in range(count):
        for k in range(i):
            share = factor[i, k]
            for j in range(k + 1):
                out[i, j] -= share * out[k, j]
        for j in range(i):
            out[i, j] /= factor[i, i]
        out[i, i] = 1 / factor[i, i]
    return out


@inlined
def _given(equations, count, kept):  # type: ignore
    """
    Return the conditional moments of the first eliminated unknowns, given those that are left.

    :param count: number of eliminated unknowns.
    :param kept: number of these that are asked for.
    :return: (kept, left) coefficients of the unknowns that are left, (kept,) means where these
        are 0, and (kept, kept) covariance.
    """
    inverse = _inverse(equations, count)
    left = len(equations) - count - 1
    by, mean, own = np.zeros((kept, left)), np.zeros(kept), np.zeros((kept, kept))
    for k in range(count):
        for i in range(min(k + 1, kept)):
            share = inverse[k, i]
            mean[i] += share * equations[count + left, k]
            for j in range(left):
                by[i, j] -= share * equations[count + j, k]
            for j in range(min(k + 1, kept)):
                own[i, j] += share * inverse[k, j]
    return by, mean, own


@inlined
def _steady(times, error, rate):  # type: ignore
    """Return equations of speeds, places and right-hand side, and the rows' log determinant."""
    n = len(times)
    equations, log_rows = np.zeros((2 * n + 1, 2 * n + 1)), 0.0
    rows, covariance = np.zeros((n - 1, 2 * n)), np.zeros((n - 1, n - 1))
    for i in range(n - 1):
        dt = times[i + 1] - times[i]
        rows[i, i] = rows[i, i + 1] = -dt / 2
        rows[i, n + i], rows[i, n + i + 1] = -1.0, 1.0
        covariance[i, i] = rate * rate * dt ** 3 / 12 + error[i] + error[i + 1]
        if i:
            covariance[i, i - 1] = -error[i]
        information = 1 / (rate * rate * dt)
        equations[i, i] += information
        equations[i + 1, i + 1] += information
        equations[i + 1, i] -= information
        log_rows += np.log(information)
    log_rows += _add_rows(equations, rows, covariance, 1)
    return equations, log_rows


@inlined
def _changing(times, error, rate, first_std):  # type: ignore
    """Return equations of speeds, accelerations, places; then as :func:`_steady`."""
    n = len(times)
    equations = np.zeros((3 * n + 1, 3 * n + 1))
    rows = np.zeros((3 * n - 3, 3 * n))
    covariance = np.zeros((3 * n - 3, 3 * n - 3))
    for i in range(n - 1):
        dt, k = times[i + 1] - times[i], 3 * i
        rows[k, 2 * n + i], rows[k, 2 * n + i + 1] = -1.0, 1.0
        rows[k, i], rows[k, n + i] = -dt, -dt * dt / 2
        rows[k + 1, i], rows[k + 1, i + 1], rows[k + 1, n + i] = -1.0, 1.0, -dt
        rows[k + 2, n + i], rows[k + 2, n + i + 1] = -1.0, 1.0
        square = rate * rate
        covariance[k, k] = square * dt ** 5 / 20 + error[i] + error[i + 1]
        covariance[k + 1, k], covariance[k + 1, k + 1] = square * dt ** 4 / 8, square * dt ** 3 / 3
        covariance[k + 2, k], covariance[k + 2, k + 1] = square * dt ** 3 / 6, square * dt ** 2 / 2
        covariance[k + 2, k + 2] = square * dt
        if i:
            covariance[k, k - 3] = -error[i]
    equations[n, n] = 1 / (first_std * first_std)
    log_rows = _add_rows(equations, rows, covariance, 3) - 2 * np.log(first_std)
    return equations, log_rows


@inlined
def _across(times, ways, drift, across_std, persists):  # type: ignore
    """
    Return equations of the heading error, offsets and right-hand side, and the log determinant.

    :param across_std: drift due to a persistent rate, m/sqrt(s); 0 for none.
    """
    n = len(times)
    equations = np.zeros((n + 2, n + 2))
    rows, covariance = np.zeros((n - 1, n + 1)), np.zeros((n - 1, n - 1))
    band = 0
    for i in range(n - 1):
        dt = times[i + 1] - times[i]
        rows[i, 0], rows[i, 1 + i], rows[i, 2 + i] = -ways[i], -1.0, 1.0
        covariance[i, i] = drift * drift * dt
        if across_std > 0:
            band = n
            scale = 0.5 * across_std ** 2 * persists
            fades = -np.expm1(-dt / persists)
            covariance[i, i] += scale * 2 * (dt / persists - fades)
            for j in range(i):
                other = -np.expm1(-(times[j + 1] - times[j]) / persists)
                covariance[i, j] = scale * fades * other * np.exp(
                    -(times[i] - times[j + 1]) / persists)
    log_rows = _add_rows(equations, rows, covariance, band)
    return equations, log_rows


@inlined
def _bounce(lag):  # type: ignore
    """Return the correlation of heights, as :func:`motion_prior.bounce`."""
    apart = abs(lag)
    return (1 + apart) * np.exp(-apart)


@inlined
def _above(times, ways, moves, ride, smooth, springs, least):  # type: ignore
    """
    Return equations of the errors of heading and crossfall, offsets and right-hand side.

    :param smooth: part of the ride that is independent in each pair; the rest are springs.
    :param springs: their natural frequency, rad/s.
    :param least: lower limit of the drift.
    :return: the equations, and the logarithm of the determinant of the rows.
    """
    smooth = min(ride, smooth)
    drift, sprung = max(smooth, least), ride * ride - smooth * smooth
    band = len(times) if sprung > 0 else 1
    n = len(times)
    equations = np.zeros((n + 3, n + 3))
    rows, covariance = np.zeros((n - 1, n + 2)), np.zeros((n - 1, n - 1))
    for i in range(n - 1):
        rows[i, 0], rows[i, 1], rows[i, 2 + i], rows[i, 3 + i] = -ways[i], -moves[i], -1.0, 1.0
        covariance[i, i] = drift * drift * (times[i + 1] - times[i]) + 2 * smooth * smooth
        if i:
            covariance[i, i - 1] = -smooth * smooth
        if sprung > 0:
            for j in range(i + 1):
                covariance[i, j] += sprung * (
                    _bounce(springs * (times[i + 1] - times[j + 1]))
                    + _bounce(springs * (times[i] - times[j]))
                    - _bounce(springs * (times[i + 1] - times[j]))
                    - _bounce(springs * (times[i] - times[j + 1])))
    log_rows = _add_rows(equations, rows, covariance, band)
    return equations, log_rows


@kernel(plain_answers, '(f8[:,:,::1], f8[:,::1], f8[:,::1], f8[::1], f8, f8[::1], f8[:,::1], '
        'f8[:,::1], i8[::1], f8[::1], i8)')
def _answers(H, right, begun, begun_right, log_rows, times, state, models,  # type: ignore
             scatters, processes, covariances):
    n, count = len(times), len(models)
    stamp_std, jerk, first_acceleration = processes[0], processes[1], processes[2]
    drift, lane_std, lane_s = processes[3], processes[4], processes[5]
    smooth, springs = processes[6], processes[7]
    least, least_error = processes[8], processes[9]
    error = np.maximum(stamp_std * np.abs(state[:, 3]), least_error) ** 2
    ways, moves = state[1:, 0] - state[:-1, 0], state[1:, 1] - state[:-1, 1]
    # parts that models share: motion along, across and above the path
    kinds = np.empty((count, 3), np.int64)
    parts = [np.zeros((1, 1))]
    by, means, own = [np.zeros((1, 1))], [np.zeros(1)], [np.zeros((1, 1))]
    logs, kept = [0.0], [0]
    for m in range(count):
        for axis in range(3):
            of, kinds[m, axis] = models[m, axis], -1
            for other in range(m):
                same = models[other, axis] == of or (
                    np.isnan(of) and np.isnan(models[other, axis]))
                if same and kinds[m, axis] < 0:
                    kinds[m, axis] = kinds[other, axis]
            if kinds[m, axis] >= 0:
                continue
            kinds[m, axis] = len(parts)
            if axis == 0:
                asked = n
                if np.isnan(of):
                    gone = 2 * n
                    part, log = _changing(times, error, max(jerk, least),
                                          max(first_acceleration, least))
                else:
                    gone = n
                    part, log = _steady(times, error, max(of, least))
                part[0, 0] += begun[3 * n, 3 * n]
                part[-1, 0] += begun_right[3 * n]
            elif axis == 1:
                gone = asked = 1
                part, log = _across(times, ways, max(drift, least),
                                    lane_std if of > 0 else 0.0, lane_s)
                part[0, 0] += begun[4 * n, 4 * n]
                part[-1, 0] += begun_right[4 * n]
            else:
                gone = asked = 2
                part, log = _above(times, ways, moves, of, smooth, springs, least)
                for k in range(2):
                    part[k, k] += begun[4 * n + 1 + k, 4 * n + 1 + k]
                    part[-1, k] += begun_right[4 * n + 1 + k]
            log -= _eliminate(part, gone)
            given, mean, around = _given(part, gone, asked)
            parts.append(part)
            logs.append(log)
            by.append(given)
            means.append(mean)
            own.append(around)
            kept.append(asked)
    # each model
    size = 4 * n + 3
    evidence, out = np.empty(count), np.empty((count, size))
    covariance = np.zeros((count if covariances else 0, size, size))
    first = np.array([3 * n, 4 * n, 4 * n + 1])  # first index of each part's eliminated unknowns
    for m in range(count):
        total = np.zeros((3 * n + 1, 3 * n + 1))
        for i in range(3 * n):
            for j in range(i + 1):
                total[i, j] = H[scatters[m], i, j] + begun[i, j]
            total[3 * n, i] = right[scatters[m], i] + begun_right[i]
        log = log_rows
        for axis in range(3):
            part = parts[kinds[m, axis]]
            log += logs[kinds[m, axis]]
            last = len(part) - 1
            start = last - n
            for i in range(n):
                for j in range(i + 1):
                    total[3 * i + axis, 3 * j + axis] += part[start + i, start + j]
                total[3 * n, 3 * i + axis] += part[last, start + i]
            total[3 * n, 3 * n] += part[last, last]
        log -= _eliminate(total, 3 * n)
        evidence[m] = 0.5 * (log - total[3 * n, 3 * n])
        for i in range(3 * n - 1, -1, -1):
            entry = total[3 * n, i]
            for k in range(i + 1, 3 * n):
                entry -= total[k, i] * out[m, k]
            out[m, i] = entry / total[i, i]
        for axis in range(3):
            kind = kinds[m, axis]
            for i in range(kept[kind]):
                entry = means[kind][i]
                for j in range(n):
                    entry += by[kind][i, j] * out[m, 3 * j + axis]
                out[m, first[axis] + i] = entry
        if covariances:
            inverse = _inverse(total, 3 * n)
            root = np.zeros((size, 3 * n))  # root @ root.T: covariance due to that of the poses
            for i in range(3 * n):
                for k in range(i, 3 * n):
                    root[i, k] = inverse[k, i]
            for axis in range(3):
                kind = kinds[m, axis]
                for i in range(kept[kind]):
                    for j in range(n):
                        share = by[kind][i, j]
                        for k in range(3 * n):
                            root[first[axis] + i, k] += share * root[3 * j + axis, k]
            np.dot(root, root.T, covariance[m])
            for axis in range(3):
                kind = kinds[m, axis]
                for i in range(kept[kind]):
                    for j in range(kept[kind]):
                        covariance[m, first[axis] + i, first[axis] + j] += own[kind][i, j]
    return evidence, out, covariance
