# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``multimodal``: particles weighted by disparity, colour and gradient cues.

R. Munoz-Salinas, M. Garcia-Silvente, R. Medina Carnicer, "Adaptive multi-modal stereo people
tracking without background modelling", J. Visual Communication and Image Representation 19(2),
2008, with the two changes that the 2012 paper makes for its comparison (Section V-A): the front is
a quadrangle, and the depth map is compared with the front's plane, which is perpendicular to the
path. As in the paper, the dynamics are those of our tracker (2012, eq. 24, 27); instead of
manoeuvre models, a share of the particles tries one.

- Disparity: semi-global matching around the front; the median difference to the particle's
  plane (their paper takes the mean, which background at the front's edges would bias).  Its
  weight in the likelihood is the share of the particles' fronts that has a disparity, the
  confidence that makes the method adaptive.
- Colour: histograms in both views against references that adapt.  The images are grey, so the
  histograms are of grey levels.
- Gradient: across the outline of the front in both views, relative to the best particle.
"""
from __future__ import annotations

from dataclasses import replace
from typing import Optional

import numpy as np
from numpy.typing import NDArray

from .cues import bhattacharyya, histograms, outline_gradient
from .particle_tracker import ParticleTracker
from .rectify import Rectifier
from .settings import MultimodalSettings
from ...core.records import Array, StereoPair
from ...tracking.front import plane_points
from ...tracking.initialise import first_states, Placement
from ...tracking.protocol import TrackStart
from ...vision.grey import to_eight_bits
from ...vision.haar import CELLS, PartGrid

_SPAN_PX = 6.0  # margin of the searched disparities beyond those of the particles
_MARGIN_PX = 8  # margin around the fronts of the particles in the disparity map
_GRID = np.stack(np.meshgrid((np.arange(8) + 0.5) / 8 - 0.5, (np.arange(5) + 0.5) / 5 - 0.5),
                 axis=-1).reshape(-1, 2)  # samples of the front, as shares of its size
_STEP_M = np.array([0.05, 0.0, 0.0])  # step of the central differences along the path
_TAIL = 0.01  # share of outlying particles that the region of the disparity map ignores


class MultimodalTracker(ParticleTracker[MultimodalSettings]):
    """
    Particles of (s, a, b, v) with the cues of the module's docstring; see :class:`Baseline`.

    Resampled particles are spread by the same kernel as those of ``unconstrained``.
    """

    Settings = MultimodalSettings
    freedom = 4

    def __init__(self, start: TrackStart, placed: Placement, settings: MultimodalSettings
                 ) -> None:
        super().__init__(start, placed, settings)
        self.states = first_states(start, placed, placed.s_std_m)
        self.grid = PartGrid(self.config.parts, CELLS)
        self.rectifier = Rectifier(self.rig)
        self.samples_m = _GRID * np.ptp(placed.front.corners_m, axis=0)
        self.references: Optional[tuple[Array, Array]] = None

    # -- the filter's steps -----------------------------------------------------------------

    def _move(self, dt_s: float) -> None:
        """Apply a random walk of the speed, and drift across and above the path (eq. 24, 27)."""
        c, root = self.config, np.sqrt(dt_s)
        s, a, b, v = self.states.T
        noise = self.rng.standard_normal((3, len(s))) * root
        v_next = v + self._manoeuvres(c.speed_rate_std, self.settings.along_rate_std) * noise[2]
        across = self._manoeuvres(c.drift_across_std_m, c.manoeuvre_across_std_m)
        self.states = np.column_stack([
            s + 0.5 * (v + v_next) * dt_s, a + across * noise[0],
            b + c.drift_up_std_m * noise[1], v_next])

    def _observe(self, pair: StereoPair) -> bool:
        """Update by a pair, converted to 8 bits."""
        return super()._observe(
            replace(pair, left=to_eight_bits(pair.left), right=to_eight_bits(pair.right)))

    def _score(self, pair: StereoPair) -> Array:
        """Return the sum of the log-likelihoods of all cues."""
        quads = self._quads(self.states, pair.right_lag_s)
        shown = np.asarray(np.isfinite(np.concatenate(quads, axis=1)).all(axis=(1, 2)))
        if not shown.any():
            return np.full(len(shown), -np.inf)
        fill = int(np.argmax(shown))
        total = np.zeros(len(shown))
        for view, image in enumerate((pair.left, pair.right)):
            q = np.where(shown[:, None, None], quads[view], quads[view][fill])
            if self.references is not None:
                same = bhattacharyya(
                    histograms(image, q, self.grid), self.references[view])
                total -= self.settings.lambda_colour * (1 - same)  # squared distance
            edge = outline_gradient(image, q)
            total -= self.settings.lambda_gradient * np.square(
                1 - edge / max(float(edge.max()), 1e-6))
        total += self._depth_score(pair)
        return np.where(shown, total, -np.inf)

    def _depth_score(self, pair: StereoPair) -> Array:
        """Return the (N,) log-likelihood of the disparity map."""
        points = plane_points(self.lane.path, self.states[:, :3], self.samples_m)
        late = points + pair.right_lag_s * self._velocities(self.states)[:, None]
        uv, expected = self.rectifier.project(points, late)
        ahead = np.asarray(np.isfinite(expected).all(axis=1))
        if not ahead.any():
            return np.zeros(len(ahead))
        low = np.floor(np.quantile(uv[ahead].min(axis=1), _TAIL, axis=0)) - _MARGIN_PX
        high = np.ceil(np.quantile(uv[ahead].max(axis=1), 1 - _TAIL, axis=0)) + _MARGIN_PX
        span = np.quantile(expected[ahead], [_TAIL, 1 - _TAIL])
        found = self.rectifier.disparity(pair.left, pair.right, low, high,
                                         (span[0] - _SPAN_PX, span[1] + _SPAN_PX))
        off = _nearest(found, uv - low) - expected
        share = np.isfinite(off).mean(axis=1)
        enough = share > self.settings.least_disparity_share
        if not enough.any():
            return np.zeros(len(enough))
        square = np.square(np.nanmedian(off[enough], axis=1) / self.settings.disparity_std_px)
        score = np.full(len(off), -0.5 * float(square.max()))  # without depth: the worst score
        score[enough] = -0.5 * square
        return score * float(share.mean())

    def _accept(self, pair: StereoPair) -> bool:
        """Return whether the mean state resembles the references; if so, adapt them to it."""
        found = [histograms(image, q, self.grid)[0] for image, q in
                 zip((pair.left, pair.right), self._mean_quads(pair.right_lag_s))]
        if self.references is None:
            self.references = found[0], found[1]
            return True
        if min(float(bhattacharyya(f, g))
               for f, g in zip(found, self.references)) < self.settings.least_similarity:
            return False
        rate = self.settings.reference_rate
        left, right = (rate * f + (1 - rate) * g for f, g in zip(found, self.references))
        self.references = left, right
        return True

    # -- geometry ---------------------------------------------------------------------------

    def _quads(self, states: Array, lag_s: float = 0.0) -> tuple[Array, Array]:
        later = None
        if lag_s:
            later = states[:, :3].copy()
            later[:, 0] += lag_s * states[:, 3]
        return self.placed.front.corners(self.rig, states[:, :3], 0.0, later)

    def _axes(self, states: Array) -> Array:
        return self.lane.path.frame(states[:, 0])

    def _centres(self, states: Array) -> Array:
        return plane_points(self.lane.path, states[:, :3], np.zeros((1, 2)))[:, 0]

    def _velocities(self, states: Array) -> Array:
        ahead, behind = (plane_points(self.lane.path, states[:, :3] + step, np.zeros((1, 2)))
                         for step in (_STEP_M, -_STEP_M))
        return np.asarray(states[:, 3:4] * (ahead - behind)[:, 0] / (2 * _STEP_M[0]))


def _nearest(image: NDArray[np.float32], uv: Array) -> Array:
    """Return the values of an image at the pixels nearest to (..., 2) positions; NaN outside."""
    safe = np.where(np.isfinite(uv), uv, -1e6)
    out = np.full(uv.shape[:-1], np.nan)
    u, v = (np.rint(safe[..., k]).astype(int) for k in (0, 1))
    inside = (u >= 0) & (v >= 0) & (u < image.shape[1]) & (v < image.shape[0])
    out[inside] = image[v[inside], u[inside]]
    return out
