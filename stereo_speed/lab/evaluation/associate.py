# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Match tracks to true vehicles by their places, one to one."""
from __future__ import annotations

from typing import Mapping, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from ...core.records import Array, TrackUpdate
from ...io.truth import VehicleTruth

# Depth is what stereo knows least; a tracker that is this far off is not on the vehicle.
GATE_M, GATE_SHARE = 4.0, 0.15
# The nearer part of its places decides: a track that leaves its vehicle later is still that
# vehicle's, with the errors it then makes.
NEARER_SHARE = 0.25


def distance(track: Sequence[TrackUpdate], truth: VehicleTruth) -> float:
    """
    Tell how far a track is from a vehicle, in gates: 1 is the farthest that can be matched.

    :param track: updates of one track.
    :return: quantile of the distances at common stamps; infinite when there is none.
    """
    rows = truth.at([u.stamp_ns for u in track])
    there = truth.position_m[rows]
    known = (rows >= 0) & np.isfinite(there).all(axis=1)
    if not known.any():
        return np.inf
    here = np.array([u.position_m for u in track])[known]
    gate = np.maximum(GATE_M, GATE_SHARE * np.abs(there[known, 2]))
    return float(np.quantile(np.linalg.norm(here - there[known], axis=1) / gate, NEARER_SHARE))


def match(tracks: Mapping[int, Sequence[TrackUpdate]],
          truths: Sequence[VehicleTruth]) -> dict[int, int]:
    """
    Match tracks to vehicles, one to one, with the least sum of distances within the gate.

    Where the truth tells no places and there is but one vehicle, it gets the longest track.

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
    # What is beyond the gate costs more than any assignment within it.
    far = 1.0 + len(names) * len(truths)
    rows, columns = linear_sum_assignment(np.where(cost <= 1.0, cost, far))
    return {truths[i].vehicle: names[j] for i, j in zip(rows, columns) if cost[i, j] <= 1.0}
