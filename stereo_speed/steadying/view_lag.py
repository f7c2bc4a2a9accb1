# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The time between the exposures of the two views, seen in what moves.

Where the stamps of a pair differ, they may be those of the exposures, or of some driver that
stamps when an image arrives. What stands still looks the same either way; what moves does not:
after the time tau a point is off its epipolar line in the right view by

    e = u tau + e0,

with u the speed at which its image crosses that line, known from its track, and e0 what the
calibration leaves. The details of each tracked front are matched between the views without regard
to the line, and e and u of all of them make a linear regression for tau and e0.

Either tau is what the stamps say plus a constant, or it is a constant whatever the stamps say;
where the stamps' differences vary, the images tell which of both.  Depth along the baseline b is
lost by x = V tau, so speeds are wrong by the share (V b) / b^2 for each second that tau is wrong.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Any, Iterable, Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.records import Array, StereoPair, TrackState, TrackUpdate
from ..geometry.rig import StereoRig
from ..vision.subpixel import parabola_peak

_PRIOR_S = 0.02  # 1-sigma of what the stamps are wrong by, before anything is seen
_OFFSET_PX = 0.1  # 1-sigma of e0
_LOOK_PX = 0.15  # 1-sigma of one match; those of one vehicle share the faults of its front
_SPEED_SHARE = 0.05  # 1-sigma of u, as a share
_LOOKS = 400  # that the estimate rests on, the newest
_LEAST_NCC = 0.7
_LEAST_PX, _MOST_PX = 12, 96  # size of what is matched
_REACH_PX, _REACH_S = 4.0, 0.06  # of the search: always, and for what moves
_SIGNIFICANT = 1.0  # sigmas
_LEAST_CHANGE_S = 1e-4
_VARIED_S = 5e-4  # standard deviation of the stamps' differences from which they can be judged
_CLEARLY = 9.0  # difference of chi^2
_EPSILON_S = 1e-3


@dataclass(frozen=True)
class _Look:
    """
    One front in one pair.

    :param gap_s: difference of the stamps, as they came.
    :param across_px: e, how far it is off its epipolar line.
    :param rate_px_s: u, at which it crosses the line.
    """

    gap_s: float
    across_px: float
    rate_px_s: float


@dataclass(frozen=True)
class LagState:
    """
    What is known of the time between the views.

    :param correction_s: what is added to the difference of the stamps, or the difference itself.
    :param constant: whether it is the difference itself, whatever the stamps say.
    :param std_s: 1-sigma of what is still wrong with it.
    :param gap_s: the usual difference of the stamps.
    :param looks: fronts in pairs that this rests on.
    """

    correction_s: float
    constant: bool
    std_s: float
    gap_s: float
    looks: int


class ViewLag:
    """
    See the module's docstring.

    :param rig: the cameras.
    """

    def __init__(self, rig: StereoRig) -> None:
        self.rig = rig
        self._looks: deque[_Look] = deque(maxlen=_LOOKS)
        self._applied, self._constant, self._std_s = 0.0, False, _PRIOR_S
        self._off_s = 0.0  # what the newest estimate says otherwise than what is applied
        self._gap_s = 0.0
        self.changes_s = 0.0  # sum of the sizes of all changes of what is applied

    @property
    def concerned(self) -> bool:
        """Return whether the newest pair had two stamps."""
        return self._gap_s != 0.0

    @property
    def std_s(self) -> float:
        """Return the 1-sigma of the time between the views, s; 0 where one trigger made both."""
        return float(np.hypot(self._std_s, self._off_s)) if self.concerned else 0.0

    @property
    def state(self) -> Optional[LagState]:
        """Return what is known; None where one trigger makes both images."""
        return LagState(self._applied, self._constant, self.std_s, self._gap_s,
                        len(self._looks)) if self.concerned else None

    def corrected(self, pair: StereoPair) -> StereoPair:
        """Return a pair with the right stamp that the images speak for."""
        self._gap_s = pair.right_lag_s
        if not self._gap_s or not self._applied and not self._constant:
            return pair
        lag_s = self._applied + (0.0 if self._constant else self._gap_s)
        return replace(pair, right_stamp_ns=pair.stamp_ns + round(lag_s * 1e9),
                       right_came_ns=pair.right_stamp_ns)

    def observe(self, pair: StereoPair, updates: Iterable[TrackUpdate]) -> None:
        """
        Take in where the fronts of a pair are seen.

        :param pair: as taken, its motion included.
        :param updates: of its tracks.
        """
        if not self.concerned:
            return
        rig = self.rig.as_taken(pair.motion)
        looks = [look for update in updates if update.state is not TrackState.COASTING
                 if (look := _look(pair, update, rig, self._gap_s)) is not None]
        if looks:
            self._looks.extend(looks)
            self._decide()

    def share(self, update: TrackUpdate, doubt_s: float = 0.0) -> float:
        """
        Return the 1-sigma of the speed of a track by this, as a share.

        :param doubt_s: by which the time has changed since the track began.
        """
        centre = -self.rig.R.T @ self.rig.t
        velocity_mps = update.speed_mps * update.axes[:, 0]
        per_s = abs(float(velocity_mps @ centre)) / float(centre @ centre)
        return per_s * float(np.hypot(self.std_s, doubt_s))

    def _decide(self) -> None:
        """Solve both regressions, and apply what is significant."""
        gap, across, rate = np.array([(k.gap_s, k.across_px, k.rate_px_s) for k in self._looks]).T
        added = _solve(across, rate, gap)
        best, constant = added, False
        if np.std(gap) > _VARIED_S:
            fixed = _solve(across, rate, np.zeros_like(gap))
            margin = 0.0 if self._constant else _CLEARLY
            if fixed.chi2 < added.chi2 - margin:
                best, constant = fixed, True
        self._std_s = best.std_s
        known = constant == self._constant
        change_s = abs(best.tau_s - self._applied) if known else abs(
            best.tau_s - self._applied - (float(np.mean(gap)) if constant else 0.0))
        self._off_s = best.tau_s - self._applied if known else 0.0
        if not known or change_s > max(_SIGNIFICANT * best.std_s, _LEAST_CHANGE_S):
            self._applied, self._constant, self._off_s = best.tau_s, constant, 0.0
            self.changes_s += change_s


@dataclass(frozen=True)
class _Regression:
    """tau, its 1-sigma, and how badly the regression fits."""

    tau_s: float
    std_s: float
    chi2: float


def _solve(across_px: Array, rate_px_s: Array, known_s: Array) -> _Regression:
    """
    Return tau of e = u (known + tau) + e0, with priors about 0; far outliers count little.

    :param across_px: e (n,).
    :param rate_px_s: u (n,).
    :param known_s: (n,) the part of the time that tau is added to.
    """
    tau, wanted = 0.0, across_px - rate_px_s * known_s
    weight = np.ones(len(across_px))
    columns = np.column_stack([rate_px_s, np.ones(len(rate_px_s))])
    for _ in range(5):
        variance = _LOOK_PX**2 + (_SPEED_SHARE * rate_px_s * (known_s + tau))**2
        w = weight / variance
        information = (columns * w[:, None]).T @ columns + np.diag(
            [_PRIOR_S**-2, _OFFSET_PX**-2])
        x = np.linalg.solve(information, (columns * w[:, None]).T @ wanted)
        residual = (wanted - columns @ x) / np.sqrt(variance)
        weight, tau = 1.0 / (1.0 + residual**2 / 9.0), float(x[0])
    # What fits worse than foreseen is known less well.
    excess = max(1.0, float(np.sum(weight * residual**2) / max(len(residual) - 2, 1)))
    std_s = float(np.sqrt(excess * np.linalg.inv(information)[0, 0]))
    return _Regression(tau, std_s, float(np.sum(np.log1p(residual**2 / 9.0)) * 9.0))


def _look(pair: StereoPair, update: TrackUpdate, rig: StereoRig, gap_s: float
          ) -> Optional[_Look]:
    """Return how far a front is off its epipolar line; None where it cannot be matched."""
    rate = _rate(update, rig)
    left_px, right_px = update.quad_left_px, update.quad_right_px
    low, high = np.ceil(left_px.min(axis=0)), np.floor(left_px.max(axis=0))
    middle = (low + high) / 2
    half = np.minimum((high - low) / 2, _MOST_PX / 2).round()
    if 2 * half.min() < _LEAST_PX:
        return None
    low, high = (middle - half).round().astype(int), (middle + half).round().astype(int)
    patch = _cut(pair.left, low, high)
    reach = int(np.ceil(_REACH_PX + _REACH_S * np.abs(rate).max()))
    guess = low + (right_px.mean(axis=0) - left_px.mean(axis=0)).round().astype(int)
    window = _cut(pair.right, guess - reach, guess + (high - low) + reach)
    if patch is None or window is None:
        return None
    scores = np.asarray(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED), np.float64)
    row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
    if scores[row, column] < _LEAST_NCC or not (
            0 < row < scores.shape[0] - 1 and 0 < column < scores.shape[1] - 1):
        return None
    du, dv = float(parabola_peak(scores[row, :, None])[0][0]), float(
        parabola_peak(scores[:, column, None])[0][0])
    centre = (low + high - 1) / 2
    found = centre + (guess - reach - low) + np.array([du, dv])
    return _Look(gap_s, float(_across(rig, centre, found)),
                 float(_across(rig, update_centre(update), _later(update, rig)) / _EPSILON_S))


def update_centre(update: TrackUpdate) -> Array:
    """Return the pixel (2,) of a front's centre in the left view."""
    return np.asarray(update.quad_left_px.mean(axis=0))


def _rate(update: TrackUpdate, rig: StereoRig) -> Array:
    """Return the speed (2,) of a front's image in the right view, px/s."""
    moved = update.position_m + _EPSILON_S * update.speed_mps * update.axes[:, 0]
    both, _ = rig.right.project(rig.to_right(np.stack([update.position_m, moved])))
    return np.asarray((both[1] - both[0]) / _EPSILON_S)


def _later(update: TrackUpdate, rig: StereoRig) -> Array:
    """Return where the content of a front's centre is in the right view a moment later, px."""
    centre = rig.triangulate(update_centre(update), update.quad_right_px.mean(axis=0))
    moved = centre + _EPSILON_S * update.speed_mps * update.axes[:, 0]
    return np.asarray(rig.right.project(rig.to_right(moved))[0])


def _across(rig: StereoRig, left_px: Array, right_px: Array) -> float:
    """Return how far below its epipolar line a right pixel is, px."""
    line = rig.epipolar_lines_right(np.asarray(left_px, dtype=np.float64))
    ray = rig.right.rays(np.asarray(right_px, dtype=np.float64))
    off = float(line @ ray) / float(np.hypot(line[0], line[1]))
    return off * float(rig.right.K[1, 1])


def _cut(image: NDArray[Any], low: NDArray[Any], high: NDArray[Any]
         ) -> Optional[NDArray[np.float32]]:
    """Return the pixels of an image from a corner to another; None where it has not all."""
    (x0, y0), (x1, y1) = low, high
    if x0 < 0 or y0 < 0 or y1 > image.shape[0] or x1 > image.shape[1]:
        return None
    return np.asarray(image[y0:y1, x0:x1], dtype=np.float32)
