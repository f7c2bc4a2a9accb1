# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Cross-sections of a line of the road, in a raw image.

A cross-section runs across the road at one arc length and is measured in true metres. The middle
of a painted band is therefore its middle in space, however obliquely the camera sees it.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .empty_road import Background, LIGHT_STEP_PX
from ...core.records import Array
from ...road.fitted import RoadFit
from ...road.occlusion import hidden
from ...road.path import chord_lengths

SPACING_PX = 1.5  # spacing of cross-sections along the line; closer ones share their pixels
BORDER_PX = 3.0  # width of the image border, where the spline knows only one side
_DENSE = 4000  # places along a line at which its image is sampled
_OCCLUSION_SAMPLES = 160  # places along a line at which its occlusion by the road is checked
_STEP_M = 0.02  # step for finite differences along and across the line
_BESIDE_M = np.linspace(-0.3, 0.3, 13)  # places across the line where the light must be steady
_STEADY_SHARE = 0.75  # least share of these places with steady light
_FEWEST_STEADY = 8  # cross-sections in steady light that tell how bright a line usually is
_LEAST_LIGHT_GREY = 20.0  # brightness at which the contrast of paint is well above the noise
_MIN_SINE = 0.12  # least sine of the angle between the line and a cross-section in the image


@dataclass(frozen=True, eq=False)
class CrossSections:
    """
    Cross-sections of one line in one view.

    :param s_m: (n,) reference arc lengths, m.
    :param arc_px: (n,) lengths along the line in the image, px.
    :param px_per_m: (n,) image scale across the line, px/m.
    :param swept: (n,) whether the light there changes over time.
    """

    s_m: Array
    arc_px: Array
    px_per_m: Array
    swept: NDArray[np.bool_]

    def take(self, where: NDArray[np.bool_]) -> CrossSections:
        """Return the selected cross-sections."""
        return CrossSections(
            self.s_m[where], self.arc_px[where], self.px_per_m[where], self.swept[where])


@dataclass(frozen=True, eq=False)
class LineView:
    """
    One line of a road in one view.

    :param fit: the road as known so far.
    :param line: number of the line.
    :param right: whether the view is the right one.
    :param view: the view without traffic.
    """

    fit: RoadFit
    line: int
    right: bool
    view: Background

    @property
    def noise_grey(self) -> float:
        """Return the 1-sigma of the noise, grey levels."""
        return self.view.noise_grey

    def seen(self, s_m: Array, across_m: Array) -> Array:
        """
        Return the raw pixels (n, ..., 2) of places beside the line.

        :param s_m: (n,) reference arc lengths, m.
        :param across_m: (n, ...) distances from the line, m, positive to the left.
        """
        return self.fit.seen(self.fit.points(self.line, s_m, across_m), self.right)

    def read(self, sections: CrossSections, across_m: Array) -> Array:
        """
        Return the grey levels (n, k) along cross-sections, NaN outside the image.

        Those that lamps sweep are no brighter than the others, so as not to outweigh them.

        :param across_m: (n, k) distances from the line along each cross-section, m.
        """
        grey = self.view.spline(self.seen(sections.s_m, across_m))
        swept = sections.swept
        if swept.any() and np.count_nonzero(~swept) >= _FEWEST_STEADY:
            known = np.isfinite(grey)
            light = np.where(known, grey, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
            usual = max(float(np.median(light[~swept])), _LEAST_LIGHT_GREY)
            grey[swept] *= (usual / np.maximum(light[swept], usual))[:, None]
        return grey

    def sections(self, ends_px: Array, steady_share: float = np.inf) -> CrossSections:
        """
        Return evenly spaced cross-sections of the line, without those that the road occludes.

        :param ends_px: (2, 2) raw pixels of the two ends of the line.
        :param steady_share: largest change of light over time that counts as none, as a share of
            the grey level and apart from exposure.
        """
        feet = self.fit.foot(self.line, self.right, ends_px)
        s = np.linspace(feet.min(), feet.max(), _DENSE)
        uv = self.seen(s, np.zeros_like(s))
        rig = self.fit.problem.rig
        camera = rig.right if self.right else rig.left
        size = np.array([camera.width_px, camera.height_px])
        # A bad road may lead close to the camera, where a metre may span a million pixels.
        visible = ((uv > -size) & (uv < 2 * size)).all(axis=-1)
        if not visible.any():
            none = np.zeros(0)
            return CrossSections(none, none, none, none.astype(bool))
        s, arc = s[visible], chord_lengths(uv[visible])
        arcs = np.linspace(0, arc[-1], max(int(arc[-1] / SPACING_PX), 2))
        at, zeros = np.interp(arcs, arc, s), np.zeros(len(arcs))
        near = self.seen(at, np.tile([-_STEP_M, 0.0, _STEP_M], (len(at), 1)))
        along = self.seen(at + _STEP_M, zeros) - self.seen(at - _STEP_M, zeros)
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        across = (near[:, 2] - near[:, 0]) / (2 * _STEP_M)
        px_per_m = np.abs(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0])
        good = ((near[:, 1] >= BORDER_PX) & (near[:, 1] <= size - 1 - BORDER_PX)).all(axis=-1)
        good &= px_per_m > _MIN_SINE * np.linalg.norm(across, axis=-1)
        coarse = np.linspace(s[0], s[-1], _OCCLUSION_SAMPLES)
        good &= np.interp(at, coarse, hidden(self.fit, self.line, self.right, coarse)) == 0
        at, arcs, px_per_m = at[good], arcs[good], px_per_m[good]
        return CrossSections(at, arcs, px_per_m, self._swept(at, steady_share))

    def _swept(self, s_m: Array, most_share: float) -> NDArray[np.bool_]:
        """
        Return at which arc lengths (n,) the light changes over time.

        Headlamps sweep the road, and their reflections a wet one.
        """
        change = self.view.change
        if change is None or not len(s_m):
            return np.zeros(len(s_m), dtype=bool)
        uv = self.seen(s_m, np.tile(_BESIDE_M, (len(s_m), 1))) / LIGHT_STEP_PX
        last = np.array(change.shape[::-1]) - 1
        u, v = np.moveaxis(np.clip(np.rint(np.nan_to_num(uv)), 0, last).astype(int), -1, 0)
        return np.asarray(np.quantile(change[v, u], _STEADY_SHARE, axis=1) > most_share)
