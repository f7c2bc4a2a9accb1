# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Cross-sections of a line of the road, in a raw image.

A cross-section runs across the road at one arc length and is measured in true metres. The middle
of a painted band is therefore its middle in space, however obliquely the camera sees it.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np
from numpy.typing import NDArray

from .empty_road import Background, LIGHT_STEP_PX
from ...core.records import Array
from ...road.fitted import RoadFit
from ...road.occlusion import hidden
from ...road.path import chord_lengths
from ...vision.spline_image import SplineImage

SPACING_PX = 1.5  # spacing of cross-sections along the line; closer ones share their pixels
BORDER_PX = 3.0  # width of the image border, where the spline knows only one side
_DENSE = 4000  # places along a line at which its image is sampled
_OCCLUSION_SAMPLES = 160  # places along a line at which its occlusion by the road is checked
_STEP_M = 0.02  # step for finite differences along and across the line
_BESIDE_M = np.linspace(-0.3, 0.3, 13)  # places across the line where the light must be steady
_STEADY_SHARE = 0.75  # least share of these places with steady light
_MIN_SINE = 0.12  # least sine of the angle between the line and a cross-section in the image


@dataclass(frozen=True, eq=False)
class CrossSections:
    """
    Cross-sections of one line in one view.

    :param s_m: (n,) reference arc lengths, m.
    :param arc_px: (n,) lengths along the line in the image, px.
    :param px_per_m: (n,) image scale across the line, px/m.
    """

    s_m: Array
    arc_px: Array
    px_per_m: Array

    def take(self, where: NDArray[np.bool_]) -> CrossSections:
        """Return the selected cross-sections."""
        return CrossSections(self.s_m[where], self.arc_px[where], self.px_per_m[where])


@dataclass(frozen=True, eq=False)
class LineView:
    """
    One line of a road in one view.

    :param fit: the road as known so far.
    :param line: number of the line.
    :param right: whether the view is the right one.
    :param image: the view without traffic.
    :param noise_grey: 1-sigma of the noise, grey levels.
    :param change: see :class:`.empty_road.Background`.
    """

    fit: RoadFit
    line: int
    right: bool
    image: SplineImage
    noise_grey: float
    change: Optional[NDArray[np.float32]] = None

    @classmethod
    def of(cls, fit: RoadFit, line: int, right: bool, view: Background) -> LineView:
        """Return a line of a road in the background of a view."""
        return cls(fit, line, right, view.spline, view.noise_grey, view.change)

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

        :param across_m: (n, k) distances from the line along each cross-section, m.
        """
        return self.image(self.seen(sections.s_m, across_m))

    def sections(self, ends_px: Array) -> CrossSections:
        """
        Return evenly spaced cross-sections of the line, without those that the road occludes.

        :param ends_px: (2, 2) raw pixels of the two ends of the line.
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
            return CrossSections(*np.zeros((3, 0)))
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
        return CrossSections(at, arcs, px_per_m).take(good)

    def steady(self, sections: CrossSections, most_share: float) -> NDArray[np.bool_]:
        """
        Return for which cross-sections (n,) the light hardly changes over time.

        Headlamps that sweep the road, and their reflections on a wet one, leave false edges.

        :param most_share: largest change, as a share of the grey level.
        """
        if self.change is None:
            return np.ones(len(sections.s_m), dtype=bool)
        uv = self.seen(sections.s_m, np.tile(_BESIDE_M, (len(sections.s_m), 1))) / LIGHT_STEP_PX
        last = np.array(self.change.shape[::-1]) - 1
        u, v = np.moveaxis(np.clip(np.rint(np.nan_to_num(uv)), 0, last).astype(int), -1, 0)
        return np.asarray(np.quantile(self.change[v, u], _STEADY_SHARE, axis=1) <= most_share)
