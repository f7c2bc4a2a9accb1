# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Refines a proposal to a front: its depth by both views, its middle and width by its symmetry.

The window is at the height of bumpers.  Each round moves the plane to the depth at which both
views agree and samples again, which converges to the plane on which the front stands.  Fronts and
rears are symmetric: the axis gives their middle to a few centimetres, and the outermost edges that
are mirrored and stand at the same depth give their width.

Where the right view is exposed later, each round first estimates the speed of the front from the
left views of two pairs, and samples the right view as far ahead as follows from it.
"""
from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .config import FrontConfig, MotionConfig
from .front_sampler import FrontHypothesis, FrontSampler, GRID_M, ROWS
from .lane_geometry import LaneGeometry
from .patch_kernels import BAND, cut, edges, Floats, mirrored, plain_correlate, shifted, symmetry
from .patches import level_rows
from .plane_sweep import Proposal
from .pyramid import PairPyramids, Patches
from .temporal_match import find_travel, Interval
from ..vision.subpixel import parabola_peak

HALF = 42  # samples from the axis to the edge of the window, half the width of a lorry
_SHIFTS = 4  # greatest shift between the views either way, in samples
_ASIDE_M = 1.4  # reach of the first search for the axis, to either side
_CLOSE_M = 0.3  # reach of later searches for the axis, to either side
_MIDDLE = 25  # samples from the axis to the edge of the part that determines the axis later
_STRIDE = 2  # step of samples in the first search for the axis
_DARK = 16.0  # grey levels added before the logarithm, which would overweight dark pixels
_ROUNDS = 5  # rounds after which a proposal has converged or never will
_SETTLED_M = 0.006  # shift of the right view below which the depth has converged
_MOST_M = 8.0  # greatest step of depth
_SAME_S_M = 1.5  # fronts nearer along the lane, and _SAME_X_M across, are one
_SAME_X_M = 0.3  # fronts nearer across the lane, and _SAME_S_M along, are one
_ALIKE = 0.5  # least correlation of a front's edges, mirrored and with the other view
_WEAK_SHARE = 0.5  # least strength of an edge, as a share of the strongest
_LEAST_HALF_M = 0.45  # least distance of a front's edges from the axis
_NARROW_SHARE = 0.4  # the same for narrow fronts, as a share of their least width
_BEYOND_M = 0.06  # a front extends beyond its outermost strong edges, often those of lamps
_OFF_SHIFTS = 1  # tolerance of heights and depths in comparing the views, in samples
AS_SHARP = 0, 0  # pyramid levels relative to the usual one, left and right
_LEAST_RATE = 0.2  # least rate of depth, relative to rest; below it motion hides the depth


@dataclass(frozen=True)
class FrontKind:
    """
    A kind of front, and where its middle and its edges are searched for.

    :param low_m: height above the road of the lower edge of the window, m.
    :param high_m: height above the road of the upper edge of the window, m.
    :param least_width_m: least width of such a front, m.
    :param narrow_m: greatest width of such a front, which must not be part of a wider one, m; None
        where it may be as wide as a lorry.
    """

    low_m: float
    high_m: float
    least_width_m: float
    narrow_m: Optional[float] = None

    @property
    def half(self) -> int:
        """Return the number of samples from the axis to the edge of the widest front."""
        return HALF if self.narrow_m is None else round(self.narrow_m / 2 / GRID_M)

    @property
    def middle(self) -> int:
        """Return the number of samples from the axis that determine the axis in the end."""
        return _MIDDLE if self.narrow_m is None else self.half

    @property
    def least_half(self) -> int:
        """Return the number of samples from the axis in which no outer edge is searched for."""
        least_m = _LEAST_HALF_M if self.narrow_m is None else _NARROW_SHARE * self.least_width_m
        return round(least_m / GRID_M)


@dataclass(frozen=True, eq=False)
class FrontBatch:
    """
    Places that are refined together.

    :param s_m: (n,) arc lengths, m.
    :param x_m: (n,) offsets of their axes to the left of the path, m.
    :param half_m: (n,) halves of their widths, m.
    :param ahead_m: (n,) distances travelled until the right view is exposed, m.
    :param shift_m: (n,) shifts of the right view at which it agrees with the left one, m.
    :param cross_ncc: (n,) left-right correlations there.
    :param symmetry: (n,) correlations with their mirror images.
    """

    s_m: Floats
    x_m: Floats
    half_m: Floats
    ahead_m: Floats
    shift_m: Floats
    cross_ncc: Floats
    symmetry: Floats

    def __len__(self) -> int:
        return len(self.s_m)

    @classmethod
    def of(cls, proposals: Sequence[Proposal]) -> FrontBatch:
        """Return a batch of proposals before their first round."""
        none = np.zeros(len(proposals))
        return cls(s_m=np.array([p.s_m for p in proposals]),
                   x_m=np.array([p.x_m for p in proposals]),
                   half_m=np.array([p.half_m for p in proposals]),
                   ahead_m=np.array([p.ahead_m for p in proposals]),
                   shift_m=none, cross_ncc=none, symmetry=none)

    def take(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> FrontBatch:
        """Return some of them, by a mask or by their indices."""
        return FrontBatch(*(getattr(self, f.name)[which] for f in fields(self)))

    def hypotheses(self) -> list[FrontHypothesis]:
        """Return them one by one."""
        return [FrontHypothesis(s_m=s, x_m=x, half_m=half, ahead_m=ahead, cross_ncc=ncc,
                                symmetry=symmetry)
                for s, x, half, ahead, ncc, symmetry in zip(
                    *(values.tolist() for values in (
                        self.s_m, self.x_m, self.half_m, self.ahead_m, self.cross_ncc,
                        self.symmetry)))]


class FrontRefiner:
    """
    Refines proposals of one lane.

    :param geometry: the lane.
    :param kind: kind of the fronts that are searched for.
    :param front: parameters of fronts.
    :param motion: parameters of their motion, for views that have two stamps.
    :param least_symmetry: least correlation of a front with its mirror image; None where fronts
        need not be symmetric.
    """

    def __init__(self, geometry: LaneGeometry, kind: FrontKind, front: FrontConfig,
                 motion: MotionConfig, least_symmetry: Optional[float] = None) -> None:
        self.sampler, self.kind = FrontSampler(geometry, kind.low_m, kind.high_m), kind
        self.front, self.motion, self.least_symmetry = front, motion, least_symmetry

    def refine(self, proposals: Sequence[Proposal], interval: Interval, noise: float,
               symmetric: bool = True, speed_known: bool = False) -> list[FrontHypothesis]:
        """
        Refine proposals in one batch.

        :param proposals: the proposals.
        :param interval: the pair, and an earlier one.
        :param noise: 1-sigma of a grey value.
        :param symmetric: whether middle and width are found by symmetry; otherwise those of the
            proposals are kept.
        :param speed_known: whether ``ahead_m`` of the proposals is known and kept.
        """
        batch, now = FrontBatch.of(proposals), interval.now
        out: list[FrontHypothesis] = []
        for round_ in range(_ROUNDS):
            if not len(batch):
                break
            if symmetric and round_ == 0:
                batch = replace(batch, x_m=self._axis(batch, now))
            if now.pair.right_lag_s and not speed_known:
                batch = replace(batch, ahead_m=self._ahead(batch, interval, round_ == 0))
            batch = self._observe(batch, now, noise, symmetric)
            settled = (np.abs(batch.shift_m) < _SETTLED_M) & (round_ > 0)
            done = settled & (2 * batch.half_m >= self.kind.least_width_m)
            if symmetric and done.any():
                done[done] = self._is_middle(batch.take(done), now, noise)
            out += batch.take(done).hypotheses()
            step_m = np.clip(batch.shift_m / self._rate(batch), -_MOST_M, _MOST_M)
            batch = replace(batch, s_m=batch.s_m + step_m)
            stay = ~settled & (batch.cross_ncc > self.front.hopeless_ncc)
            if symmetric:
                stay &= batch.symmetry > self.front.hopeless_ncc
            batch = batch.take(np.flatnonzero(stay))
            batch = batch.take(np.array(_distinct(batch, symmetric), dtype=np.int64))
        return out

    def standing_ncc(self, front: FrontHypothesis, now: PairPyramids,
                     coarser: tuple[int, int] = AS_SHARP) -> float:
        """
        Return the best correlation of the views of a standing front, within a small tolerance.

        :param coarser: pyramid levels, coarser than the usual one, of the left and the right view.
        """
        return self._views_ncc(front, now, False, coarser)

    def lying_ncc(self, front: FrontHypothesis, now: PairPyramids,
                  coarser: tuple[int, int] = AS_SHARP) -> float:
        """Return the correlation of the views if what looks like a front lay on the road."""
        return self._views_ncc(front, now, True, coarser)

    def _views_ncc(self, front: FrontHypothesis, now: PairPyramids, lying: bool,
                   coarser: tuple[int, int]) -> float:
        s, x, ahead = (np.array([v]) for v in (front.s_m, front.x_m, front.ahead_m))
        half = round(front.half_m / GRID_M)
        left = level_rows(self.sampler.left(s, x, half, now, coarser=coarser[0]))
        right = self.sampler.right(s, x, half + _OFF_SHIFTS, now, ahead, lying=lying,
                                   coarser=coarser[1])
        width = left.shape[2]
        return max(float(plain_correlate(left, level_rows(right[:, :, k:k + width]))[0])
                   for k in range(2 * _OFF_SHIFTS + 1))

    def is_one_body(self, front: FrontHypothesis, now: PairPyramids,
                    sharpnesses: Sequence[tuple[int, int]] = (AS_SHARP,)) -> bool:
        """
        Return whether both halves of a front stand at the same depth, as far as the views tell.

        At night the lamp of one vehicle and the lamp of another farther away look like those of a
        car between them.  Together they correlate well enough at the depth in the middle.  A half
        without details of its own has no depth, and belongs to the other one.

        :param sharpnesses: trial pyramid levels, coarser than the usual one, of the left and the
            right view; those at which the views of the halves agree best count.
        """
        places, nccs = max((self._halves(front, now, coarser) for coarser in sharpnesses),
                           key=lambda halves: float(halves[1].min()))
        return bool(nccs.min() < self.front.least_cross_ncc
                    or np.ptp(places) * GRID_M < self.apart_shift_m(front.s_m))

    def _halves(self, front: FrontHypothesis, now: PairPyramids, coarser: tuple[int, int]
                ) -> tuple[Floats, Floats]:
        """
        Return the places (2,) in the right view of both halves of a front, and their correlations.

        :param coarser: pyramid levels, coarser than the usual one, of the left and the right view.
        :return: places in samples, and the correlations (2,) there.
        """
        s, x, ahead = (np.array([v]) for v in (front.s_m, front.x_m, front.ahead_m))
        left = self.sampler.left(s, x, HALF + _SHIFTS, now, coarser=coarser[0])
        right = self.sampler.right(s, x, HALF + _SHIFTS, now, ahead, coarser=coarser[1])
        whole, side = _mask(np.array([front.half_m])), np.arange(-HALF, HALF + 1)
        places, nccs = zip(*(
            parabola_peak(shifted(left, right, np.array([_SHIFTS]), whole & half, _SHIFTS)[:, 0])
            for half in (side < 0, side > 0)))
        return np.array(places), np.array(nccs)

    def apart_shift_m(self, s_m: float) -> float:
        """
        Return the shift of the right view from which on things at two depths are two vehicles.

        :param s_m: arc length of the plane, m.
        :return: the shift on the plane, m.
        """
        rates, apart_m = self.sampler.geometry.rates(np.array([s_m])), self.front.apart_m
        shift, range_m, px_per_m = (
            abs(float(v[0])) for v in (rates.shift, rates.ahead_m, rates.px_per_m))
        # The rate of the shift is that at the plane; farther away it gets less.
        farther_m = shift * apart_m * range_m / (range_m + apart_m)
        return max(farther_m, self.front.apart_px / px_per_m)

    def _ahead(self, batch: FrontBatch, interval: Interval, first: bool) -> Floats:
        """Return the distances (n,) travelled during the lag, from the left views of two pairs."""
        lag_s = interval.now.pair.right_lag_s
        return np.array([
            find_travel(self.sampler, front, interval, self.motion,
                        None if first else front.ahead_m / lag_s * interval.seconds
                        ).gone_m / interval.seconds * lag_s for front in batch.hypotheses()])

    def _rate(self, batch: FrontBatch) -> Floats:
        """
        Return the shift of the right view (n,) per metre that a front truly is further along.

        A front that is nearer than assumed has also travelled less than assumed.
        """
        rates = self.sampler.geometry.rates(batch.s_m)
        if not batch.ahead_m.any():
            return rates.shift
        rate = rates.shift + rates.slide * batch.ahead_m / rates.ahead_m
        seen = np.abs(rate) > _LEAST_RATE * np.abs(rates.shift)
        return np.where(seen, rate, rates.shift)

    def _axis(self, batch: FrontBatch, now: PairPyramids) -> Floats:
        """
        Return the axes (n,) with the most mirrored contrast, in a window as wide as a lorry.

        The amount counts and not its share, because each lamp is symmetric by itself.  Logarithms
        keep lamps from dominating.
        """
        aside, half = round(_ASIDE_M / GRID_M / _STRIDE), self.kind.half // _STRIDE
        both = self.sampler.both(batch.s_m, batch.x_m, (half + aside) * _STRIDE, now,
                                 batch.ahead_m, _STRIDE)
        both = np.log(np.maximum(both, 0.0) + _DARK)
        energy, _ = mirrored(both, 2 * half + 1)
        return np.asarray(batch.x_m + (np.argmax(energy, axis=1) - aside) * _STRIDE * GRID_M)

    def _is_middle(self, batch: FrontBatch, now: PairPyramids, noise: float
                   ) -> NDArray[np.bool_]:
        """
        Return whether fronts (n,) lie at the axis with most mirrored contrast, or none is there.

        A dark vehicle and its shadow are symmetric about an axis between them, where there is no
        front.  A lamp of a front does not count as a front, because the front at the axis does.
        """
        axis_m = self._axis(batch, now)
        middle = np.asarray(np.abs(axis_m - batch.x_m) < _CLOSE_M)
        if self.least_symmetry is None or self.kind.narrow_m is not None or middle.all():
            return middle
        others = self._observe(replace(batch, x_m=axis_m).take(~middle), now, noise, True)
        middle[~middle] = others.symmetry < self.least_symmetry
        return middle

    def _observe(self, batch: FrontBatch, now: PairPyramids, noise: float, symmetric: bool
                 ) -> FrontBatch:
        """Return the batch updated by both views."""
        aside = round(_CLOSE_M / GRID_M)
        both = self.sampler.both(batch.s_m, batch.x_m, HALF + aside + _SHIFTS, now, batch.ahead_m)
        moved = np.full(len(batch), aside)
        if symmetric:
            beside = HALF + _SHIFTS - self.kind.middle
            moved = _middle_axis(both[:, :, beside:-beside], self.kind.middle)
        width, start = 2 * HALF + 1, moved + _SHIFTS
        wide, right = (np.ascontiguousarray(view) for view in (both[:, :ROWS], both[:, ROWS:]))
        left = cut(wide, start, width)
        mask = _mask(batch.half_m)
        place, ncc = parabola_peak(shifted(wide, right, start, mask, _SHIFTS))
        matched = cut(right, start - _SHIFTS + np.round(place).astype(np.int64), width)
        half_m = batch.half_m
        if symmetric:
            half_m = np.minimum(_half_width(left, matched, noise, self.kind) + _BEYOND_M,
                                self.kind.half * GRID_M)
        mask = _mask(half_m)
        return replace(batch, x_m=batch.x_m + (moved - aside) * GRID_M, half_m=half_m,
                       shift_m=(place - _SHIFTS) * GRID_M, cross_ncc=ncc,
                       symmetry=(symmetry(left, mask) + symmetry(matched, mask)) / 2)


def _middle_axis(both: Patches, middle: int) -> NDArray[np.int64]:
    """Return the windows (n,) in which the middle of a front is most symmetric."""
    found, most = mirrored(np.ascontiguousarray(both), 2 * middle + 1)
    return np.asarray(np.argmax(found / most, axis=1))


def _mask(half_m: Floats) -> NDArray[np.bool_]:
    """Return the columns (n, 2 HALF + 1) within half a width (n,) of the axis."""
    columns = np.abs(np.arange(-HALF, HALF + 1)) * GRID_M
    return np.asarray(columns <= half_m[:, None] + 1e-9)


def _half_width(left: Patches, right: Patches, noise: float, kind: FrontKind) -> Floats:
    """
    Return the distances of the outermost edges that are mirrored and at this depth in both views.

    :param left: (n, rows, 2 HALF + 1) windows of the left view.
    :param right: the same of the right view, already shifted to agree.
    :param noise: 1-sigma of a grey value; edges that may be noise do not count.
    :param kind: kind of the fronts.
    :return: (n,) m from the axis; 0 where there are none.
    """
    alike, same, weaker = edges(left, right)
    weaker[:, :kind.least_half] = 0  # edges inside a front are not its outline
    weaker[:, kind.half - 1:] = 0
    alike = np.where((alike > _ALIKE) & (same > _ALIKE) & (weaker > noise), weaker, 0.0)
    good = alike > _WEAK_SHARE * alike.max(axis=1, keepdims=True)
    last = HALF - np.argmax(good[:, ::-1], axis=1)
    near = last[:, None] - np.arange(BAND + 1)  # a band responds before it reaches the edge
    edge = last - np.argmax(np.take_along_axis(weaker, np.maximum(near, 0), axis=1), axis=1)
    return np.asarray(np.where(good.any(axis=1), edge, 0) * GRID_M)


def _distinct(batch: FrontBatch, symmetric: bool) -> list[int]:
    """Return the indices of places that are not near a better one."""
    s, x = batch.s_m, batch.x_m
    out: list[int] = []
    for k in np.argsort(-(batch.symmetry if symmetric else batch.cross_ncc), kind='stable'):
        if all(abs(s[k] - s[j]) > _SAME_S_M or abs(x[k] - x[j]) > _SAME_X_M for j in out):
            out.append(int(k))
    return out
