# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The pose of the rig in each pair: sway of the whole rig, and drift of the right camera.

The rotation of each camera is measured separately (``view_rotation``).  The common part is sway,
which comes and goes from pair to pair.  The difference is drift of the right camera, which creeps
slowly, or jumps when somebody knocks the camera.  While nothing moves, only some pairs are looked
at.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Iterable, Optional, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from .config import SteadyingConfig
from .drift_filter import DriftFilter
from .rest import Rest, STILL_PAIRS
from .view_rotation import Rotated, ViewRotation
from ..core.records import Array, RigMotion, StereoPair
from ..geometry.rig import StereoRig

_ORDER = [1, 0, 2]  # indices of pan, tilt and roll in the components of a rotation vector
_LEAST_PROBABILITY = 0.5  # of a sway; less probable ones are ignored, as of a static rig
_MOST_ODDS = 500.0  # bound of the log odds, against overflow


@dataclass(frozen=True)
class Steadiness:
    """
    What has been found so far; angles are pan, tilt and roll in degrees.

    :param pairs: number of pairs.
    :param looks: number of these pairs whose rotation was measured.
    :param unknown: number of looks in which the rotation could not be determined.
    :param swayed: number of looks in which the rig had swayed.
    :param sway_rms_deg: r.m.s. of the sway about the rest of the rig.
    :param rest_deg: current rest of the rig, relative to how it stood when the site was learnt.
    :param standing_std_deg: 1-sigma of how the rig stands in the site, as far as its sway makes
        that uncertain; zeros if it has not swayed, or the lines of the site tell it.
    :param drift_deg: drift of the right camera relative to the left one; zeros if it has not
        turned.
    :param drift_std_deg: 1-sigma of the drift.
    :param turns: number of sudden turns of the right camera.
    """

    pairs: int = 0
    looks: int = 0
    unknown: int = 0
    swayed: int = 0
    sway_rms_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rest_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    standing_std_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drift_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drift_std_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turns: int = 0


@dataclass(frozen=True, eq=False)
class Reference:
    """
    The pair that others are compared with.

    :param pair: the pair.
    :param rest_rad: (3,) pan, tilt and roll from the rig in that pair to the rig at rest, which is
        how it stands in the site, rad.
    :param covariance_rad2: (3, 3) their covariance, rad^2.
    """

    pair: StereoPair
    rest_rad: Array
    covariance_rad2: Array


class Steadier:
    """
    Estimates the pose of the rig pair by pair; see the module's docstring.

    :param rig: the rig as it stands in the reference.
    :param config: parameters.
    :param reference: reference that pairs are compared with; None for the first pair that shows
        details.  The rig then stands in the site as in that pair or, if it sways from the start,
        as in the mean of its first pairs.

    ``unsettled_ns`` is the stamp of the last pair until which too few poses told how a swaying rig
    stands in the site; None if there is none.
    """

    def __init__(self, rig: StereoRig, config: SteadyingConfig,
                 reference: Optional[Reference] = None) -> None:
        self.rig, self.config, self.reference = rig, config, reference
        self._prior_std_rad = math.radians(config.sway_std_deg)
        self._right_of_left = rig.R[np.ix_(_ORDER, _ORDER)]
        self.reset()

    def reset(self) -> None:
        """Forget everything except the reference, as after time has jumped back."""
        self._views: Optional[tuple[ViewRotation, ViewRotation]] = None
        self._has_details = False  # whether the reference shows enough to compare with
        self.drift = DriftFilter(self.config)
        self._square: Array = np.zeros(3)
        self._pairs = self._looks = self._unknown = self._swayed = self._missed = 0
        self._still_looks = self._last_look_ns = 0
        self._drift_pair = 0  # number of the pair with the last measurement of the drift
        self._rest = Rest(self._prior_std_rad)
        self._fixed_standing: Optional[tuple[Array, Array]] = None
        self.unsettled_ns: Optional[int] = None
        if self.reference is not None:
            self._learn(self.reference.pair)
            self._fixed_standing = self.reference.rest_rad, self.reference.covariance_rad2

    def steady(self, pair: StereoPair) -> StereoPair:
        """Return a pair with the motion of the rig filled in."""
        self._pairs += 1
        sway = self._look(pair) if self._is_due(pair) else np.zeros(3)
        sway, drift = self._from_rest(sway), self.drift.corrected_rad
        if not (np.any(sway) or np.any(drift)):
            return pair
        return replace(pair, motion=RigMotion(_angles(sway), _angles(drift)))

    def _is_due(self, pair: StereoPair) -> bool:
        """Return whether to look at a pair; after a while without motion, only some are due."""
        waited = pair.stamp_ns - self._last_look_ns >= self.config.look_interval_s * 1e9
        return self._views is None or waited or (
            self._has_details and self._still_looks < self.config.still_looks)

    def _look(self, pair: StereoPair) -> Array:
        """Return the sway (3,) in a pair, rad, and update drift and appearance by it."""
        before = self._swayed, self.drift.turns
        self._looks += 1
        if self._missed >= self.config.renew_pairs or not self._has_details:
            # There are none yet, or the known details are gone for good, as by night or by road
            # works: the rest is learnt, anew.
            self._learn(pair)
        left, right = self._measured(pair)
        if left is not None and right is not None:
            # The reference compared with itself carries no information, not even its own noise.
            if pair.stamp_ns != self._reference_pair.stamp_ns:
                self._update_drift(left, right, self._pairs - self._drift_pair)
            self._drift_pair = self._pairs
        self._learn_appearance(pair, (left, right))
        self._last_look_ns = pair.stamp_ns
        sway = self._sway(left, right)
        moved = self.lost or before != (self._swayed, self.drift.turns)
        self._still_looks = 0 if moved else self._still_looks + 1
        return sway

    @property
    def _sways(self) -> bool:
        """Return whether the rig has swayed since the reference, or stood swayed in it."""
        return self._rest.moves or bool(self.standing[0].any())

    @property
    def lost(self) -> bool:
        """Return whether the rig sways and its pose in the newest pair is unknown."""
        return self._missed > 0 and self._sways

    def _learn(self, pair: StereoPair) -> None:
        """Compare with another pair from now on, whose pose relative to the rest is unknown."""
        self._views = (ViewRotation(self.rig.left, pair.left, self.config),
                       ViewRotation(self.rig.right, pair.right, self.config))
        self._has_details = any(view.has_enough for view in self._views)
        self._reference_pair, self._missed = pair, 0
        self.drift.renew()
        # A right camera that has turned before is already turned in this reference.
        self._drift_base = self.drift.mean_rad
        self._last_rad: Array = np.zeros(3)
        self._rest, self._fixed_standing = Rest(self._prior_std_rad), None

    @property
    def _drift_seen_rad(self) -> Array:
        """Return the drift (3,) of the right camera since the reference, rad."""
        return self.drift.mean_rad - self._drift_base

    def _from_rest(self, sway_rad: Array) -> Array:
        """Return the sway relative to the rest, given the sway relative to the reference, rad."""
        site_rad = self.standing[0]
        if not np.any(site_rad):
            return sway_rad
        whole, rest = (Rotation.from_rotvec(_vector(a)) for a in (sway_rad, site_rad))
        return np.asarray((rest.inv() * whole).as_rotvec()[_ORDER])

    @property
    def standing(self) -> tuple[Array, Array]:
        """
        Return how the rig stands in the site: the angles (3,) from the reference, and covariance.

        Unless the reference tells, this is the rest of its first pairs, rad and rad^2.
        """
        return self._fixed_standing or self._rest.standing

    @property
    def learnt(self) -> Optional[Reference]:
        """Return the reference with the rest of all pairs so far; None before the first one."""
        return None if self._views is None else Reference(
            self._reference_pair, *self._rest.standing)

    @property
    def settling(self) -> bool:
        """Return whether too few poses have told yet how a swaying rig stands in the site."""
        return self.unsettled_ns is not None and self.unsettled_ns == self._last_look_ns

    @property
    def standing_is_fixed(self) -> bool:
        """Return whether later pairs do not change how the rig stands in the site."""
        return self._fixed_standing is not None

    @property
    def standing_covariance_rad2(self) -> Array:
        """Return the covariance (3, 3) of the rotation vector by which that is uncertain."""
        return np.asarray(self.standing[1][np.ix_(_ORDER, _ORDER)])

    @property
    def rest(self) -> RigMotion:
        """Return the current rest of the rig, relative to its pose when the site was learnt."""
        return RigMotion(_angles(self._from_rest(self._rest.mean_rad)),
                         _angles(self.drift.corrected_rad))

    def state(self) -> Steadiness:
        """Return what has been found so far."""
        known = max(self._looks - self._unknown, 1)
        mean_square = self._square / known
        return Steadiness(
            pairs=self._pairs, looks=self._looks, unknown=self._unknown, swayed=self._swayed,
            sway_rms_deg=_degrees(np.sqrt(mean_square)),
            rest_deg=_degrees(self._from_rest(self._rest.mean_rad)),
            standing_std_deg=_degrees(np.sqrt(np.diag(self.standing[1]))),
            drift_deg=_degrees(self.drift.corrected_rad),
            drift_std_deg=_degrees(np.sqrt(np.diag(self.drift.covariance_rad2))),
            turns=self.drift.turns)

    def _measured(self, pair: StereoPair) -> tuple[Optional[Rotated], Optional[Rotated]]:
        """Return the rotation of each camera; None for one whose rotation is unknown."""
        if self._views is None:
            raise RuntimeError('no pair to measure against')
        left = self._views[0].measure(pair.left, self._last_rad)
        if left is not None:
            self._last_rad = left.angles_rad
        # The right camera has most likely moved with the left one.
        right = self._views[1].measure(
            pair.right, self._right_of_left @ self._last_rad + self._drift_seen_rad)
        return left, right

    def _learn_appearance(self, pair: StereoPair, found: Sequence[Optional[Rotated]]) -> None:
        """Learn the appearance of a pair in each view whose rotation is known."""
        renewed = [view.learn(image, rotated) for view, image, rotated
                   in zip(self._views or (), (pair.left, pair.right), found)
                   if rotated is not None]
        if any(renewed):
            self.drift.renew()

    def _update_drift(self, left: Rotated, right: Rotated, pairs: int) -> None:
        """Update the drift by the rotations of both cameras, after so many pairs."""
        turned = _vector(left.angles_rad)
        rig = self._right_of_left
        # Composed exactly, because large rotations do not commute.
        whole = Rotation.from_rotvec(self.rig.R @ turned)
        base, since = (Rotation.from_rotvec(_vector(a))
                       for a in (self._drift_base, right.angles_rad))
        alone = whole.inv() * base * since
        self.drift.update(alone.as_rotvec()[_ORDER], right.covariance_rad2
                          + rig @ left.covariance_rad2 @ rig.T, pairs)

    def _sway(self, left: Optional[Rotated], right: Optional[Rotated]) -> Array:
        """Return the sway (3,) of the rig, rad; zeros if it has probably stood still."""
        information: Array = np.zeros((3, 3))
        weighted_sum: Array = np.zeros(3)
        if left is not None:
            information = information + np.linalg.inv(left.covariance_rad2)
            weighted_sum = weighted_sum + np.linalg.solve(left.covariance_rad2, left.angles_rad)
        if right is not None:
            back = self._right_of_left.T
            spread = back @ (right.covariance_rad2 + self.drift.covariance_rad2) @ back.T
            information = information + np.linalg.inv(spread)
            weighted_sum = weighted_sum + np.linalg.solve(
                spread, back @ (right.angles_rad - self._drift_seen_rad))
        if left is None and right is None:
            self._unknown, self._missed = self._unknown + 1, self._missed + 1
            return self._rest.mean_rad if self._sways else np.zeros(3)
        self._missed = 0
        covariance: Array = np.asarray(np.linalg.inv(information), np.float64)
        angles = covariance @ weighted_sum
        probability = self._sway_probability(angles, covariance)
        swayed = probability > _LEAST_PROBABILITY
        self._swayed += swayed
        self._update_rest(angles, swayed)
        return probability * angles if swayed else np.zeros(3)

    def _sway_probability(self, angles: Array, covariance: Array) -> float:
        """Return the probability that the rig has swayed."""
        prior = self.config.sway_probability
        if prior in (0.0, 1.0):
            return prior
        wide = covariance + np.radians(self.config.sway_std_deg) ** 2 * np.eye(3)
        odds = math.log(prior / (1 - prior)) + 0.5 * float(
            angles @ (np.linalg.solve(covariance, angles) - np.linalg.solve(wide, angles))
            + np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(wide)[1])
        return 1 / (1 + math.exp(-min(max(odds, -_MOST_ODDS), _MOST_ODDS)))

    def _update_rest(self, angles: Array, swayed: bool) -> None:
        """Update the rest and the sway about it by the pose in a pair."""
        rest = self._rest
        rest.add(angles, self._last_look_ns, swayed)
        self._square = self._square + (angles - rest.mean_rad) ** 2
        if self._fixed_standing is not None:
            return
        if rest.is_averaged or rest.pairs >= STILL_PAIRS and not rest.moves:
            self._fixed_standing = rest.standing  # what changes later is no error of the site
        elif rest.moves and not rest.is_settled:
            self.unsettled_ns = self._last_look_ns


def _vector(angles_rad: Array) -> Array:
    """Return the rotation vector (3,) of pan, tilt and roll."""
    return np.asarray(angles_rad[_ORDER])


def _angles(values: Array) -> tuple[float, float, float]:
    """Return three angles as a tuple."""
    pan, tilt, roll = (float(v) for v in values)
    return pan, tilt, roll


def _degrees(values: Array) -> tuple[float, float, float]:
    return _angles(np.degrees(values))


def rest_of(steadier: Steadier, pairs: Iterable[StereoPair]) -> Optional[Reference]:
    """
    Return a reference from one of some pairs, with the rest averaged over all of them.

    :param steadier: a new steadier.
    :param pairs: pairs spread over the time in which the rig sways; the first that shows details
        is the reference.
    :return: None if there are no pairs.
    """
    for pair in pairs:
        steadier.steady(pair)
    return steadier.learnt
