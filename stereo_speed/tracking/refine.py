# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Photometric refinement of a pass: all looks of a front, both views, one least-squares problem.

A filter that keeps only the newest reference drifts, and one that fixes the depth at the start is
wrong by the error of that start.  Here the poses of all pairs so far, the speeds between them and
the error of the path's heading are unknowns together:

- *cross*: the left and the right patch of a pair agree (eq. 16), which fixes the depth;
- *temporal*: every patch agrees with the one texture of the front, itself unknown and eliminated
  by its weighted mean (variable projection), which fixes the motion;
- *motion*: random-walk speed and drift across and above the path (eq. 24, 27).

Gauss-Newton on this gives the mean and covariance of the newest state, from this pair and
earlier ones only, and at the end of the pass the smoothed profile.
"""
from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from .looks import Look, LookSampler
from ..config import TrackerConfig
from ..filtering.gaussian import condition, NormalEquations
from ..filtering.weights import normalise_log_weights
from ..records import Array, StereoPair

_INDEPENDENT = 0.35  # share of independent samples after the low-pass of a look
_MATCH_FLOOR_PX = 0.04  # systematic matching error of one look between the views
_TEXTURE_FLOOR_PX = 0.10  # systematic error of one look against the texture: relief, light
_GAUGE_STD_M = 0.005  # the first look defines what the front's centre is
_MIN_TEXTURE_NCC = 0.5  # looks that agree less with the texture are occluded: not used
_MOVED_LIVE_PX = 0.10  # a look is taken again when its pose has moved further than this: live,
_MOVED_FINAL_PX = 0.01  # and when the pass is measured
_LIVE_ITERATIONS, _FINAL_ITERATIONS = 3, 8
_LIVE_RETAKES = 3  # looks retaken in one iteration, the most moved first: bounds the time
_MAX_LOOKS = 40  # older looks are thinned beyond this, so that the cost of a pair is bounded
_MAX_MOVE_PX = 3.0  # a step beyond the patch's linear range is cut


@dataclass(frozen=True, eq=False)
class Posterior:
    """
    Gaussian posterior of a whole pass.

    :param stamps_s: (n,) time of each pair since the first, s.
    :param mean: (n, 4) s, a, b in m and the speed along the path in m/s.
    :param covariance: (4 n, 4 n) of the rows of ``mean`` in order.
    :param cross_ncc: (n,) left-right NCC of each look.
    :param texture_ncc: (n,) NCC of each look with the texture.
    """

    stamps_s: Array
    mean: Array
    covariance: Array
    cross_ncc: Array
    texture_ncc: Array

    def lateral_rates(self) -> Array:
        """Rates (n,) at which the front moves across the path, m/s; 0 for a single pair."""
        if len(self.mean) < 2:
            return np.zeros(len(self.mean))
        return np.gradient(self.mean[:, 1], self.stamps_s)

    def at(self, k: int) -> tuple[Array, Array]:
        """Mean (4,) and covariance (4, 4) of pair ``k``."""
        n = range(len(self.mean))[k]
        block = slice(4 * n, 4 * n + 4)
        return self.mean[n], self.covariance[block, block]


@dataclass(frozen=True, eq=False)
class PassPrior:
    """
    What is known of a pass before its looks.

    :param s_m: arc length of the front in its first pair, m, and
    :param s_std_m: its 1-sigma.
    :param offset_m: (2,) offsets a, b at ``s_m`` of the ray through the front's centre in the
        first left view, which defines the centre, m.
    :param offset_slope: (2,) their change per metre of s.
    :param speed_mps: expected speed, m/s, and
    :param speed_std_mps: its 1-sigma.
    :param heading_std_rad: (2,) 1-sigma of the path's heading across and up.
    """

    s_m: float
    s_std_m: float
    offset_m: Array
    offset_slope: Array
    speed_mps: float
    speed_std_mps: float
    heading_std_rad: Array


class PassRefiner:
    """Grows with every pair of a pass; see the module's docstring."""

    def __init__(self, sampler: LookSampler, prior: PassPrior, config: TrackerConfig) -> None:
        self.sampler, self.prior, self.config = sampler, prior, config
        self.pairs: list[StereoPair] = []
        self.looks: list[Look] = []
        self.state = np.zeros((0, 4))

    def add(self, pair: StereoPair, guess: Array) -> Posterior | None:
        """
        Take in a pair and refine everything.

        :param guess: (4,) s, a, b, v where the particles say the front is.
        :return: None when the front is not wholly seen at the guess.
        """
        look = self.sampler.look(pair, guess[:3])
        if look is None:
            return None
        self.pairs.append(pair)
        self.looks.append(look)
        self.state = np.vstack([self.state, guess])
        if len(self.looks) > _MAX_LOOKS:
            self._thin()
        return self._refine(_LIVE_ITERATIONS, _MOVED_LIVE_PX, _LIVE_RETAKES)

    def finish(self) -> Posterior:
        """Refine the whole pass to convergence."""
        return self._refine(_FINAL_ITERATIONS, _MOVED_FINAL_PX, len(self.looks))

    def drop_last(self) -> None:
        """Take the newest pair out again: it was not the vehicle."""
        self.pairs.pop()
        self.looks.pop()
        self.state = self.state[:-1]

    def _thin(self) -> None:
        """Leave out the look, not the first or the newest two, that leaves the least gap."""
        times = self._times()
        worst = 1 + int(np.argmin(times[2:-1] - times[:-3]))
        del self.pairs[worst], self.looks[worst]
        self.state = np.delete(self.state, worst, axis=0)

    def _refine(self, iterations: int, moved_px: float, retake: int) -> Posterior:
        """Iterate Gauss-Newton; looks are retaken only where their pose has moved."""
        for _ in range(iterations):
            solution, covariance, cross, texture = self._solve()
            if not self._step(solution, moved_px, retake):
                break
        n = len(self.looks)
        order = np.array([[3 * k, 3 * k + 1, 3 * k + 2, 3 * n + k] for k in range(n)]).ravel()
        return Posterior(self._times(), self.state.copy(), covariance[np.ix_(order, order)],
                         cross, texture)

    def _solve(self) -> tuple[Array, Array, Array, Array]:
        """
        Solve for (poses, speeds, tilt) at the present looks under all motion models.

        A steady vehicle, a braking one and one that changes lanes differ only in the rates of
        their random walks.  The evidence of the images for each model is Gaussian and closed;
        the answer is the moments of the mixture, so that a steady pass is not made noisy for the
        sake of a braking one, nor a braking one biased.

        :return: mean, covariance, left-right NCCs and texture NCCs.
        """
        poses = np.concatenate([look.pose for look in self.looks])
        H, g, cross, texture = self._photometric()
        c, chance = self.config, self.config.manoeuvre_probability
        models = ((1 - 2 * chance, c.speed_rate_std, c.drift_across_std_m),
                  (chance, c.manoeuvre_rate_std, c.drift_across_std_m),
                  (chance, c.speed_rate_std, c.manoeuvre_across_std_m))
        means, covariances, evidence = [], [], []
        for prior, rate, across in models:
            if prior == 0:
                continue
            model_mean, model_covariance, log_evidence = condition(
                self._motion(rate, across), H, g + H @ poses)
            means.append(model_mean)
            covariances.append(model_covariance)
            evidence.append(math.log(prior) + log_evidence)
        weights = normalise_log_weights(np.array(evidence))
        mean = sum(w * m for w, m in zip(weights, means))
        spread = sum(w * (c + np.outer(m - mean, m - mean))
                     for w, m, c in zip(weights, means, covariances))
        return mean, spread, cross, texture

    def _times(self) -> Array:
        first = self.pairs[0].stamp_ns
        return np.array([(p.stamp_ns - first) * 1e-9 for p in self.pairs])

    def _step(self, solution: Array, moved_px: float, retake: int) -> bool:
        """Move to the solution and retake the looks that moved most; whether any moved."""
        n = len(self.looks)
        self.state = np.column_stack([solution[:3 * n].reshape(n, 3), solution[3 * n:4 * n]])
        changes = self.state[:, :3] - np.stack([look.pose for look in self.looks])
        px = np.array([np.abs(look.shift_px * change).max()
                       for look, change in zip(self.looks, changes)])
        moved = False
        for k in np.argsort(-px, kind='stable')[:retake]:
            if px[k] > moved_px:
                change = changes[k] * min(1.0, _MAX_MOVE_PX / px[k])
                again = self.sampler.look(self.pairs[k], self.looks[k].pose + change)
                if again is not None:
                    self.looks[k], moved = again, True
        return moved

    def _motion(self, speed_rate_std: float, across_std_m: float) -> NormalEquations:
        """
        Write down all that is known without the images.

        :param speed_rate_std: rate of the speed's random walk, m/s/sqrt(s).
        :param across_std_m: rate of the drift across the path, m/sqrt(s).
        """
        n = len(self.looks)
        normal = NormalEquations(4 * n + 2)
        p, v0 = self.prior, 3 * n
        tilt = 4 * n
        normal.row([0], [1.0], p.s_m, p.s_std_m)
        for axis in (0, 1):
            slope = float(p.offset_slope[axis])
            rest = float(p.offset_m[axis]) - slope * p.s_m
            normal.row([1 + axis, 0], [1.0, -slope], rest, _GAUGE_STD_M)
            normal.row([tilt + axis], [1.0], 0.0, float(p.heading_std_rad[axis]))
        normal.row([v0], [1.0], p.speed_mps, p.speed_std_mps)
        dt = np.diff(self._times())
        if not len(dt):
            return normal
        k = np.arange(n - 1)
        # Speed is a Wiener process: given both ends, the way between them scatters by
        # q dt^3 / 12 about their mean.
        root = np.sqrt(dt)
        speed_std = max(speed_rate_std, 1e-3) * root
        way = np.column_stack([np.ones(n - 1), -np.ones(n - 1), -dt / 2, -dt / 2])
        normal.rows(np.column_stack([3 * k + 3, 3 * k, v0 + k, v0 + k + 1]), way,
                    speed_std * dt / math.sqrt(12))
        normal.rows(np.column_stack([v0 + k + 1, v0 + k]), [1.0, -1.0], speed_std)
        ones, ds = np.ones(n - 1), np.diff(self.state[:, 0])
        for axis, drift in enumerate((across_std_m, self.config.drift_up_std_m)):
            at = np.column_stack([3 * k + 4 + axis, 3 * k + 1 + axis,
                                  np.full(n - 1, tilt + axis)])
            normal.rows(at, np.column_stack([ones, -ones, -ds]), max(drift, 1e-3) * root)
        return normal

    def _photometric(self) -> tuple[Array, Array, Array, Array]:
        """Cross and temporal terms: Hessian (3n, 3n), minus gradient (3n,), NCCs."""
        n = len(self.looks)
        H, g = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
        cross = np.zeros(n)
        for k, look in enumerate(self.looks):
            cross[k] = float(np.mean(look.patches[0] * look.patches[1]))
            block = slice(3 * k, 3 * k + 3)
            dH, dg = _cross_term(look)
            H[block, block] += dH
            g[block] += dg
        texture = self._temporal(H, g)
        return H, g, cross, texture

    def _temporal(self, H: Array, g: Array) -> Array:
        """Add the agreement with the texture; the NCC of each look with it."""
        n = len(self.looks)
        patches = np.stack([look.patches for look in self.looks])  # (n, 2, G)
        weights = np.array([look.pixels for look in self.looks])
        mean = np.tensordot(weights, patches.mean(axis=1), 1) / weights.sum()
        ncc = np.array([np.corrcoef(p.mean(axis=0), mean)[0, 1] for p in patches])
        if n < 2:
            return ncc
        w, J = np.zeros(n), np.stack([look.jacobian for look in self.looks])  # (n, 2, G, 3)
        residual = patches - mean
        for k, look in enumerate(self.looks):
            if ncc[k] < _MIN_TEXTURE_NCC:
                continue
            variance = max(float(np.mean(np.square(residual[k]))), 1e-4)
            share = _INDEPENDENT * look.pixels / patches.shape[2]
            info = share / variance * np.einsum('vgi,vgi->i', J[k], J[k])
            # Shift information beyond the systematic floor is not believed.
            per_px = info[1] / max(float(look.shift_px[0, 1] ** 2), 1e-9)
            w[k] = share / variance / (1 + _TEXTURE_FLOOR_PX ** 2 * per_px)
        total = 2 * w.sum()
        if total <= 0:
            return ncc
        texture = np.einsum('k,kvg->g', w, patches) / total
        residual = patches - texture
        summed = np.einsum('k,kvgi->gki', w, J).reshape(patches.shape[2], 3 * n)
        H -= summed.T @ summed / total
        for k in range(n):
            block = slice(3 * k, 3 * k + 3)
            H[block, block] += w[k] * np.einsum('vgi,vgj->ij', J[k], J[k])
            g[block] -= w[k] * np.einsum('vgi,vg->i', J[k], residual[k])
        return ncc


def _cross_term(look: Look) -> tuple[Array, Array]:
    """Agreement of the left and the right patch of one pair, with its systematic floor."""
    J = look.jacobian[0] - look.jacobian[1]
    r = look.patches[0] - look.patches[1]
    variance = max(float(np.mean(np.square(r))), 1e-4)
    weight = _INDEPENDENT * look.pixels / len(r) / variance
    info = weight * float(J[:, 0] @ J[:, 0])
    per_px = info / max(float(look.disparity_px[0] ** 2), 1e-12)
    weight /= 1 + _MATCH_FLOOR_PX ** 2 * per_px
    return weight * J.T @ J, -weight * J.T @ r
