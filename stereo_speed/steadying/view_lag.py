# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The time between the exposures of the two views, estimated from moving vehicles.

If the stamps of a pair differ, they may be those of the exposures, or those of a driver that
stamps images on arrival. Static objects look the same either way; moving ones do not: after the
time tau a point is off its epipolar line in the right view by

    e = f(tau) + e0,

where f is the motion of its image across that line, known from its track, and e0 is the residual
of the calibration. An approaching vehicle grows, and its image motion with it, so f is curved.
Each front is matched with the right view as it would appear at the assumed time, without being
constrained to the epipolar line. The e of all fronts give a regression for tau and e0. A front is
not flat, so the relative error of its image motion is that of its depth, the same in all looks.
Each vehicle therefore has errors of its own, and a single vehicle, however often seen, determines
tau only to some percent.

Either tau is the difference of the stamps plus a constant, or it is a constant whatever the
stamps say.  If the differences vary, the images decide which.  An error of tau shifts a point by
x = V tau along the baseline b, so the relative error of a speed is (V b) / b^2 per second of tau.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Any, Iterable, Optional, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.records import Array, StereoPair, TrackState, TrackUpdate
from ..geometry.rig import StereoRig
from ..vision.subpixel import parabola_peak

_PRIOR_S = 0.02  # prior 1-sigma of the error of the stamps
_OFFSET_PX = 0.1  # 1-sigma of e0
_LOOK_PX = 0.15  # 1-sigma of one match
# 1-sigmas of the offset and of the relative error of the motion that all looks at a vehicle share;
# the latter is that of a metre of depth at 35 m.
_FRONT_PX, _FRONT_SHARE = 0.1, 0.03
_LOOKS = 400  # number of newest looks in the estimate
_LEAST_NCC = 0.7  # least correlation of a match
_LEAST_PX, _MOST_PX = 12, 96  # least and largest size of the matched patch
_REACH_PX, _REACH_S = 4.0, 0.06  # reach of the search: a constant, and a time of image motion
_SIGNIFICANT = 1.0  # sigmas from which a change of the correction is applied
_LEAST_CHANGE_S = 1e-4  # smallest change of the correction that is applied
_VARIED_S = 5e-4  # standard deviation of the stamps' differences from which they can be judged
_LEAST_MARGIN = 9.0  # difference of chi^2 from which the stamps are found not to tell the lag
_EPSILON_S = 1e-3  # step in time for finite differences
_LEAST_MPS = 1e-3  # lower bound of the speed for relative errors
_LEAST_LONG_S = 0.01  # least time over which the curvature of the motion is determined


@dataclass(frozen=True)
class _Look:
    """
    One front in one pair.

    After the time tau it is off its epipolar line by ``rate_px_s tau + bend_px_s2 tau^2``.

    :param track: track number.
    :param gap_s: difference of the original stamps, s.
    :param across_px: e, the distance from its epipolar line, px.
    :param rate_px_s: initial rate across the line, px/s.
    :param bend_px_s2: curvature of the motion across the line, px/s^2.
    :param speed_share: relative 1-sigma of its speed.
    """

    track: int
    gap_s: float
    across_px: float
    rate_px_s: float
    bend_px_s2: float
    speed_share: float


@dataclass(frozen=True)
class LagState:
    """
    The estimate of the time between the views.

    :param correction_s: correction to the difference of the stamps, s, or, if ``constant``, the
        time itself.
    :param constant: whether the time is a constant whatever the stamps say.
    :param std_s: 1-sigma of the time between the views, s.
    :param gap_s: difference of the stamps of the newest pair, s.
    :param looks: number of looks in the estimate.
    """

    correction_s: float
    constant: bool
    std_s: float
    gap_s: float
    looks: int


class ViewLag:
    """
    Estimates the time between the views and corrects it; see the module's docstring.

    :param rig: the rig.
    """

    def __init__(self, rig: StereoRig) -> None:
        self.rig = rig
        self._looks: deque[_Look] = deque(maxlen=_LOOKS)
        self._applied, self._constant, self._std_s = 0.0, False, _PRIOR_S
        self._off_s = 0.0  # difference of the newest estimate and the applied correction
        self._gap_s = 0.0
        self.changes_s = 0.0  # sum of the absolute changes of the applied correction

    @property
    def concerned(self) -> bool:
        """Return whether the newest pair had two stamps."""
        return self._gap_s != 0.0

    @property
    def std_s(self) -> float:
        """Return the 1-sigma of the time between the views, s; 0 if they have one stamp."""
        return float(np.hypot(self._std_s, self._off_s)) if self.concerned else 0.0

    @property
    def state(self) -> Optional[LagState]:
        """Return the estimate; None if the views have one stamp."""
        return LagState(self._applied, self._constant, self.std_s, self._gap_s,
                        len(self._looks)) if self.concerned else None

    def corrected(self, pair: StereoPair) -> StereoPair:
        """Return a pair with its right stamp corrected by the estimate."""
        self._gap_s = pair.right_lag_s
        return self._with_right_stamp(pair)

    def recorrected(self, pair: StereoPair) -> StereoPair:
        """Return an earlier pair with its right stamp corrected by the present estimate."""
        came_ns = pair.right_stamp_ns if pair.right_came_ns is None else pair.right_came_ns
        return self._with_right_stamp(
            replace(pair, right_stamp_ns=came_ns, right_came_ns=None))

    def _with_right_stamp(self, pair: StereoPair) -> StereoPair:
        """Return a pair, which has its original stamps, with its right stamp corrected."""
        gap_s = pair.right_lag_s
        if not gap_s or not self._applied and not self._constant:
            return pair
        lag_s = self._applied + (0.0 if self._constant else gap_s)
        return replace(pair, right_stamp_ns=pair.stamp_ns + round(lag_s * 1e9),
                       right_came_ns=pair.right_stamp_ns)

    def observe(self, pair: StereoPair, updates: Iterable[TrackUpdate]) -> None:
        """
        Update the estimate by the fronts in a pair.

        :param pair: the pair, including its motion.
        :param updates: updates of its tracks.
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
        Return the relative 1-sigma of the speed of a track by the time between the views.

        :param doubt_s: change of the correction since the track began, s.
        """
        centre = -self.rig.R.T @ self.rig.t
        velocity_mps = update.speed_mps * update.axes[:, 0]
        per_s = abs(float(velocity_mps @ centre)) / float(centre @ centre)
        return per_s * float(np.hypot(self.std_s, doubt_s))

    def _decide(self) -> None:
        """Solve both regressions and apply a significant change."""
        gap = np.array([look.gap_s for look in self._looks])
        by_stamps = _solve(self._looks, gap)
        best, constant = by_stamps, False
        if np.std(gap) > _VARIED_S:
            by_constant = _solve(self._looks, np.zeros_like(gap))
            margin = 0.0 if self._constant else _LEAST_MARGIN
            if by_constant.chi2 < by_stamps.chi2 - margin:
                best, constant = by_constant, True
        self._std_s = best.std_s
        same_model = constant == self._constant
        usual_s = 0.0 if same_model else float(np.mean(gap))  # only one of them adds to the stamps
        change_s = abs(best.tau_s - self._applied + (-usual_s if constant else usual_s))
        self._off_s = best.tau_s - self._applied if same_model else 0.0
        if not same_model or change_s > max(_SIGNIFICANT * best.std_s, _LEAST_CHANGE_S):
            self._applied, self._constant, self._off_s = best.tau_s, constant, 0.0
            self.changes_s += change_s


@dataclass(frozen=True)
class _Regression:
    """The estimate of tau, its 1-sigma, and the misfit of the regression."""

    tau_s: float
    std_s: float
    chi2: float


def _solve(looks: Sequence[_Look], known_s: Array) -> _Regression:
    """
    Return tau of e = f(known + tau) + e0, with priors about 0, robust against outliers.

    All looks at one vehicle share errors, so each track has an unknown offset and an unknown
    relative error of its motion.

    :param looks: n looks.
    :param known_s: (n,) known part of the time, to which tau is added, s.
    """
    across, rate, bend, share = np.array([
        (k.across_px, k.rate_px_s, k.bend_px_s2, k.speed_share) for k in looks]).T
    tracks = np.unique([k.track for k in looks], return_inverse=True)[1]
    member = np.eye(int(tracks.max()) + 1)[tracks]
    prior = np.repeat([_PRIOR_S, _OFFSET_PX, _FRONT_PX, _FRONT_SHARE],
                      [1, 1, member.shape[1], member.shape[1]])**-2.0
    tau, weight = 0.0, np.ones(len(across))
    for _ in range(5):
        time_s = known_s + tau
        expected, slope = (rate + bend * time_s) * time_s, rate + 2 * bend * time_s
        variance = _LOOK_PX**2 + (share * expected)**2
        columns = np.column_stack([slope, np.ones(len(rate)), member, member * expected[:, None]])
        target, w = across - expected + slope * tau, weight / variance
        data_information = (columns * w[:, None]).T @ columns
        information = data_information + np.diag(prior)
        x = np.linalg.solve(information, (columns * w[:, None]).T @ target)
        residual = (target - columns @ x) / np.sqrt(variance)
        weight, tau = 1.0 / (1.0 + residual**2 / 9.0), float(x[0])
    # A misfit enlarges the 1-sigma. The degrees of freedom exclude what the unknowns absorb, such
    # as the only look at a vehicle, which always fits.
    covariance = np.linalg.inv(information)
    freedom = max(len(residual) - float(np.trace(covariance @ data_information)), 1.0)
    excess = max(1.0, float(np.sum(weight * residual**2)) / freedom)
    std_s = float(np.sqrt(excess * covariance[0, 0]))
    chi2 = float(np.sum(np.log1p(residual**2 / 9.0)) * 9.0 + np.sum(x[1:]**2 * prior[1:]))
    return _Regression(tau, std_s, chi2)


def _look(pair: StereoPair, update: TrackUpdate, rig: StereoRig, gap_s: float
          ) -> Optional[_Look]:
    """Return the offset of a front from its epipolar line; None if it cannot be matched."""
    left_px, right_px = update.quad_left_px, update.quad_right_px
    low, high = np.ceil(left_px.min(axis=0)), np.floor(left_px.max(axis=0))
    middle = (low + high) / 2
    half = np.minimum((high - low) / 2, _MOST_PX / 2).round()
    if 2 * half.min() < _LEAST_PX:
        return None
    low, high = (middle - half).round().astype(int), (middle + half).round().astype(int)
    at = (low + high - 1) / 2
    velocity_mps = update.speed_mps * update.axes[:, 0]  # displacement in one second
    lag_s = pair.right_lag_s
    content_m = rig.triangulate(at, _mapped(left_px, right_px, at))
    corners_m = rig.triangulate(left_px, right_px)
    # The front as the right view should show it at the assumed time.
    now_px, then_px = (_right_px(rig, corners_m + seconds * velocity_mps) for seconds in (
        lag_s, lag_s + _EPSILON_S))
    if not np.isfinite(now_px + then_px + content_m.sum()).all():
        return None
    rate_px_s = float(np.abs(then_px - now_px).max()) / _EPSILON_S
    reach = int(np.ceil(_REACH_PX + _REACH_S * rate_px_s))
    patch = _cut(pair.left, low, high)
    window = _warped(pair.right, left_px, now_px, low - reach, high + reach)
    if patch is None or window is None:
        return None
    scores = np.asarray(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED), np.float64)
    row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
    if scores[row, column] < _LEAST_NCC or not (
            0 < row < scores.shape[0] - 1 and 0 < column < scores.shape[1] - 1):
        return None
    du, dv = float(parabola_peak(scores[row, :, None])[0][0]), float(
        parabola_peak(scores[:, column, None])[0][0])
    found_px = _mapped(left_px, now_px, at + np.array([du, dv]) - reach)
    # The image motion is not uniform: an approaching point accelerates in the image.
    long_s = lag_s if abs(lag_s) > _LEAST_LONG_S else _LEAST_LONG_S
    short, long = (float(_across(rig, at, _right_px(rig, content_m + seconds * velocity_mps)))
                   for seconds in (_EPSILON_S, long_s))
    bend = (long / long_s - short / _EPSILON_S) / (long_s - _EPSILON_S)
    return _Look(update.track, gap_s, float(_across(rig, at, found_px)),
                 short / _EPSILON_S - bend * _EPSILON_S, bend,
                 update.speed_std_mps / max(abs(update.speed_mps), _LEAST_MPS))


def _right_px(rig: StereoRig, points_m: Array) -> Array:
    """Return the pixels (..., 2) of points (..., 3) in the right view, even outside the image."""
    return np.asarray(rig.right.project(rig.to_right(points_m))[0])


def _mapped(quad_px: Array, to_px: Array, points_px: Array) -> Array:
    """Return a pixel (2,) mapped by the homography from one quad (4, 2) to another."""
    matrix = cv2.getPerspectiveTransform(quad_px.astype(np.float32), to_px.astype(np.float32))
    x, y, w = matrix @ np.append(points_px, 1.0)
    return np.array([x / w, y / w])


def _warped(image: NDArray[Any], quad_px: Array, to_px: Array, low: NDArray[Any],
            high: NDArray[Any]) -> Optional[NDArray[np.float32]]:
    """
    Return an image warped so that one quad becomes another; None if that needs pixels outside it.

    :param quad_px: (4, 2) quad in the warped image.
    :param to_px: (4, 2) the same quad in the given image.
    :param low: (2,) top-left corner of the returned part of the warped image.
    :param high: (2,) its bottom-right corner.
    """
    matrix = cv2.getPerspectiveTransform(
        (quad_px - low).astype(np.float32), to_px.astype(np.float32))
    width, height = (int(n) for n in high - low)
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    seen = cv2.perspectiveTransform(corners[None], matrix)[0]
    if not (np.isfinite(seen).all() and seen.min() >= 0.0
            and (seen <= np.array(image.shape[1::-1]) - 1).all()):
        return None
    out = cv2.warpPerspective(image, matrix, (width, height),
                              flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    return np.asarray(out, dtype=np.float32)


def _across(rig: StereoRig, left_px: Array, right_px: Array) -> float:
    """Return how far a right pixel lies below the epipolar line of a left one, px."""
    line = rig.epipolar_lines_right(np.asarray(left_px, dtype=np.float64))
    ray = rig.right.rays(np.asarray(right_px, dtype=np.float64))
    off = float(line @ ray) / float(np.hypot(line[0], line[1]))
    return off * float(rig.right.K[1, 1])


def _cut(image: NDArray[Any], low: NDArray[Any], high: NDArray[Any]
         ) -> Optional[NDArray[np.float32]]:
    """Return the part of an image between two corners; None if it is not all inside."""
    (x0, y0), (x1, y1) = low, high
    if x0 < 0 or y0 < 0 or y1 > image.shape[0] or x1 > image.shape[1]:
        return None
    return np.asarray(image[y0:y1, x0:x1], dtype=np.float32)
