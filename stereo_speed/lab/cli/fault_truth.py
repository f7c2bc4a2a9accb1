# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Compares what was heard from live nodes with the truth of a bag.

A place is on a vehicle if it is in its lane, at its height, and between its front and its rear,
because a track may hold the side or the rear of a lorry. Then its speed is compared. Results on no
vehicle are counted.
"""
from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Mapping, NamedTuple, Optional, Sequence, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..evaluation.associate import GATE_DEPTH_M, GATE_DEPTH_SHARE, GATE_UP_M
from ..sim.bodies import BODIES
from ...core.records import Array
from ...io.truth import VehicleTruth

if TYPE_CHECKING:
    from ...nodes.fault_listener import HeardReading

Places = Mapping[tuple[int, str], tuple[float, float, float]]

_SIDE_M = 1.75  # half the width of a lane
# Time by which a vehicle is followed beyond its truth, which has no rows outside of the images: a
# track coasts for less.
_BEYOND_NS = 1_000_000_000
# The longest vehicle there is. The truth does not tell how long each is.
_LONGEST_M = 1.1 * max(body.length_m for body in BODIES.values())
_STANDS_M = 1e-3  # movement from row to row below which no direction is known
_DOWN = np.array([0.0, 1.0, 0.0])  # rigs are about level


class Compared(NamedTuple):
    """A measured speed relative to the true one, its 1-sigma, and its true (last) stamp."""

    error_mps: float
    std_mps: float
    ns: int


class _On(NamedTuple):
    """The vehicle that a place is on: its index, and the error of the stamp, ns."""

    vehicle: int
    off_ns: int


@dataclass(frozen=True)
class Truth:
    """
    The truth of a bag that is played with a fault.

    :param vehicles: the truth of the bag.
    :param shifts_s: by how much stamps may be off because of the fault, besides 0.
    """

    vehicles: Sequence[VehicleTruth]
    shifts_s: Sequence[float] = ()

    def of_reading(self, reading: HeardReading, places: Places) -> Optional[Compared]:
        """Compare a reading with the vehicle that it is on; None where it is on none."""
        place = places.get((reading.ns, reading.frame_id))
        on = None if place is None else self.on(reading.ns, place)
        if on is None:
            return None
        ns = reading.ns - on.off_ns
        true_mps = _speed_mps(self.vehicles[on.vehicle], np.array([ns]))
        return Compared(reading.speed_mps - true_mps, reading.std_mps, ns)

    def of_pass(self, told: Mapping[str, object], places: Places) -> Optional[Compared]:
        """
        Compare a measured pass with the mean true speed of the vehicle that it is on.

        The mean is over the time of the pass as its message gives it. The positions heard only
        tell which vehicle it is: on a busy machine few of them are published.

        :return: None if it is on none, by most of its positions.
        """
        speed, std = told['speed_mps'], told['speed_std_mps']
        first, last = told['first_stamp_ns'], told['last_stamp_ns']
        assert isinstance(speed, float) and isinstance(std, float)  # noqa: S101 (for the types)
        assert isinstance(first, int) and isinstance(last, int)  # noqa: S101
        seen = Counter(self.on(ns, place) for (ns, frame), place in places.items()
                       if frame == f'vehicle_{told["track"]}' and first <= ns <= last)
        nowhere = seen.pop(None, 0)
        if sum(seen.values()) < max(nowhere, 1):
            return None
        on, = (found for found, _ in seen.most_common(1) if found is not None)
        vehicle = self.vehicles[on.vehicle]
        slack_ns = int(np.diff(vehicle.stamps_ns).min()) // 2  # stamps may be off by some ms
        begin, end = first - on.off_ns - slack_ns, last - on.off_ns + slack_ns
        during = vehicle.stamps_ns[(vehicle.stamps_ns >= begin) & (vehicle.stamps_ns <= end)]
        if not len(during):  # the pass lies beyond the truth of its vehicle
            during = np.array([begin, end])
        return Compared(speed - _speed_mps(vehicle, during), std, last - on.off_ns)

    def on(self, ns: int, place_m: Sequence[float]) -> Optional[_On]:
        """Return the vehicle whose front is nearest of those that a place is on."""
        best: Optional[tuple[float, _On]] = None
        for index, vehicle in enumerate(self.vehicles):
            for shift_s in (0.0, *self.shifts_s):
                off_ns = round(shift_s * 1e9)
                away_m = _away_m(vehicle, ns - off_ns, np.asarray(place_m, float))
                if away_m is not None and (best is None or away_m < best[0]):
                    best = away_m, _On(index, off_ns)
        return None if best is None else best[1]


def _speed_mps(vehicle: VehicleTruth, stamps_ns: NDArray[np.int64]) -> float:
    """Return the mean true speed at stamps; beyond the truth its last one."""
    first_ns = int(vehicle.stamps_ns[0])  # as float, stamps themselves are not exact
    return float(np.interp(stamps_ns - first_ns, vehicle.stamps_ns - first_ns,
                           vehicle.speed_mps).mean())


def _away_m(vehicle: VehicleTruth, ns: int, place_m: Array) -> Optional[float]:
    """Return the distance of a place from the front of the vehicle it is on; None if not on it."""
    stamps_ns = vehicle.stamps_ns
    if len(stamps_ns) < 2 or not (
            stamps_ns[0] - _BEYOND_NS <= ns <= stamps_ns[-1] + _BEYOND_NS):
        return None
    after = int(np.clip(np.searchsorted(stamps_ns, ns), 1, len(stamps_ns) - 1))
    before_m, after_m = vehicle.position_m[after - 1], vehicle.position_m[after]
    share = (ns - int(stamps_ns[after - 1])) / int(stamps_ns[after] - stamps_ns[after - 1])
    step = after_m - before_m  # beyond its truth, a vehicle goes on as at its end
    front_m = before_m + share * step
    gap = place_m - front_m
    away_m = float(np.linalg.norm(gap))
    reach_m = max(GATE_DEPTH_M, GATE_DEPTH_SHARE * float(np.linalg.norm(place_m)))
    length_m = float(np.linalg.norm(step))
    if length_m < _STANDS_M:
        return away_m if away_m <= reach_m else None
    # Along the road, away from the camera: there is the body, also of one that shows its rear.
    along = step / length_m * (1.0 if step @ front_m > 0 else -1.0)
    side = np.cross(_DOWN, along)
    side /= float(np.linalg.norm(side))
    is_on = -reach_m <= gap @ along <= _LONGEST_M + reach_m and abs(gap @ side) <= _SIDE_M \
        and abs(gap @ np.cross(along, side)) <= GATE_UP_M
    return away_m if is_on else None
