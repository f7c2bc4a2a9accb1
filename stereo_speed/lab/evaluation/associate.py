# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Associate tracks with true vehicles by their positions, one to one.

There are two measures of proximity. ``distance`` is tolerant in depth, the least certain direction
of stereo, so that a poor tracker is scored by its errors. ``support`` distinguishes the vehicles
of dense traffic, including neighbours in the next lane.
"""
from __future__ import annotations

from typing import Mapping, Protocol, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from ...core.records import Array, TrackUpdate
from ...io.truth import VehicleTruth

# A tracker farther away than the greater of these, in m and as a share of depth, is off.
GATE_M, GATE_SHARE = 4.0, 0.15
# Quantile of the distances that decides: a track that leaves its vehicle later is still
# associated with it, and its errors count.
NEARER_SHARE = 0.25
# At a greater lateral distance a track is on a neighbour.
GATE_SIDE_M = 1.2
# Vertical gate, because the upper or the lower part of a tall vehicle may be tracked.
GATE_UP_M = 2.5
# Gate along the line of sight: the greater of these, in m and as a share of the range.
GATE_DEPTH_M, GATE_DEPTH_SHARE = 2.0, 0.06
# A track is on a vehicle if its support exceeds this share of its updates, which corresponds to
# half of the updates at half the gate.
LEAST_SUPPORT = 0.25


class Placed(Protocol):
    """The front of a track in a pair."""

    @property
    def stamp_ns(self) -> int:
        """Return the stamp of the pair."""

    @property
    def position_m(self) -> Array:
        """Return the centre of the front, (3,), left optical frame."""


def common_positions(track: Sequence[Placed], truth: VehicleTruth) -> tuple[Array, Array]:
    """Return positions of a track, (n, 3), and the true ones, where both are known."""
    rows = truth.at([u.stamp_ns for u in track])
    true = truth.position_m[rows]
    known = (rows >= 0) & np.isfinite(true).all(axis=1)
    return np.array([u.position_m for u in track]).reshape(-1, 3)[known], true[known]


def distance(track: Sequence[Placed], truth: VehicleTruth) -> float:
    """
    Return the distance of a track from a vehicle in gates; up to 1 it can be matched.

    :param track: updates of one track.
    :return: quantile of the distances at common stamps; infinite without common stamps.
    """
    found, true = common_positions(track, truth)
    if not len(true):
        return np.inf
    gate = np.maximum(GATE_M, GATE_SHARE * np.abs(true[:, 2]))
    return float(np.quantile(np.linalg.norm(found - true, axis=1) / gate, NEARER_SHARE))


def support(track: Sequence[TrackUpdate], truth: VehicleTruth) -> float:
    """Return the sum of ``nearness``: how well and how often a track is on a vehicle."""
    return float(nearness(*common_positions(track, truth)).sum())


def nearness(track_m: Array, true_m: Array) -> Array:
    """
    Return how near a track is to a vehicle: 1 at its centre, 0 from the gate on.

    :param track_m: (..., 3) centre of the tracked front, left optical frame.
    :param true_m: (..., 3) the true one.
    """
    reach = np.linalg.norm(true_m, axis=-1, keepdims=True)
    ray, gap = true_m / reach, track_m - true_m
    along = (gap * ray).sum(axis=-1, keepdims=True)
    across = gap - along * ray  # x to the side, y down: rigs are about level
    shares: Array = np.concatenate([
        along / np.maximum(GATE_DEPTH_M, GATE_DEPTH_SHARE * reach),
        across[..., :1] / GATE_SIDE_M, across[..., 1:2] / GATE_UP_M], axis=-1)
    found: Array = np.maximum(0.0, 1.0 - np.linalg.norm(shares, axis=-1))
    return found


def one_to_one(gain: Array) -> list[tuple[int, int]]:
    """Return pairs of row and column with the greatest total gain; zero gains make no pair."""
    rows, columns = linear_sum_assignment(gain, maximize=True)
    return [(int(i), int(j)) for i, j in zip(rows, columns) if gain[i, j] > 0]


def match(tracks: Mapping[int, Sequence[TrackUpdate]],
          truths: Sequence[VehicleTruth]) -> dict[int, int]:
    """
    Match tracks to vehicles, one to one, with the least sum of distances within the gate.

    If the truth has a single vehicle without positions, the longest track is matched to it.

    :param tracks: track number to its updates.
    :param truths: the vehicles.
    :return: vehicle number to track number, for those that match.
    """
    names = sorted(tracks)
    if not names or not truths:
        return {}
    if len(truths) == 1 and not np.isfinite(truths[0].position_m).any():
        return {truths[0].vehicle: max(names, key=lambda name: len(tracks[name]))}
    cost: Array = np.array([[distance(tracks[name], truth) for name in names]
                            for truth in truths])
    # Each pair within the gate gains more than the sum of all distances.
    gain = np.where(cost <= 1.0, 1.0 + cost.size - cost, 0.0)
    return {truths[i].vehicle: names[j] for i, j in one_to_one(gain)}


def vehicles_of(tracks: Mapping[int, Sequence[TrackUpdate]],
                truths: Sequence[VehicleTruth]) -> dict[int, int]:
    """
    Return the vehicle that each track is on.

    Tracks and vehicles are matched one to one, with the greatest support; each remaining track is
    a second track of a vehicle, or on none.

    :param tracks: track number to its updates.
    :param truths: the vehicles.
    :return: track number to vehicle number, for the tracks on a vehicle.
    """
    names = sorted(tracks)
    if not names or not truths:
        return {}
    gain: Array = np.array([[support(tracks[name], truth) for truth in truths] for name in names])
    enough: Array = np.array([LEAST_SUPPORT * len(tracks[name]) for name in names])
    gain = np.where(gain > enough[:, None], gain, 0.0)
    on = {names[i]: truths[int(j)].vehicle for i, j in enumerate(gain.argmax(axis=1))
          if gain[i, j] > 0}
    on.update({names[i]: truths[j].vehicle for i, j in one_to_one(gain)})
    return on
