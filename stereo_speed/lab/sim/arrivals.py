# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Motion of the traffic: vehicles enter, follow others, brake and change lanes.

Followers keep their headway by the intelligent driver model (Treiber, Hennecke, Helbing 2000). The
acceleration is constant within a step, so that position and speed are exact at any time.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Optional

import numpy as np

from .bodies import BodyConfig
from .kinematics import smooth_step
from .traffic_config import TrafficConfig

STEP_S = 0.05
G_MPS2 = 9.81
HARDEST_MPS2 = 0.6 * G_MPS2
STANDING_M = 3.0  # gap between two standing vehicles
COMFORT_MPS2 = 2.5
CHANGE_TRIES_M = 40.0  # a lane change is given up this far beyond its planned start


@dataclass(frozen=True)
class Change:
    """
    A lane change.

    :param start_s: start time, s.
    :param last_s: duration, s.
    :param from_lane: index of the lane that is left.
    :param to_lane: index of the lane that is entered.
    """

    start_s: float
    last_s: float
    from_lane: int
    to_lane: int


@dataclass
class Driver:
    """
    A vehicle on the road; lengths along travel are counted from the entry of its lane.

    :param number: number of the vehicle, in the order of entering.
    :param lane: lane that it entered in.
    :param body: its size.
    :param cruise_mps: desired speed.
    :param headway_s: time gap that it keeps.
    :param eager_mps2: desired acceleration.
    :param event: planned speed change: (position of the front at its start, m; acceleration,
        m/s^2; speed at its end, m/s), or None.
    :param change: planned lane change: (position, m; duration, s; step of lanes), or None.
    :param x_m: position of its front.
    :param v_mps: speed along the path.
    :param a_mps2: acceleration along the path.
    :param done: lane change that has begun, if any.
    """

    number: int
    lane: int
    body: BodyConfig
    cruise_mps: float
    headway_s: float
    eager_mps2: float
    event: Optional[tuple[float, float, float]]
    change: Optional[tuple[float, float, int]]
    x_m: float = 0.0
    v_mps: float = 0.0
    a_mps2: float = 0.0
    done: Optional[Change] = None

    def lanes(self, t_s: float) -> tuple[int, ...]:
        """Return the lanes that the vehicle occupies."""
        if self.done is None:
            return (self.lane,)
        if t_s < self.done.start_s + self.done.last_s:
            return self.done.from_lane, self.done.to_lane
        return (self.done.to_lane,)

    def lane_place(self, t_s: float) -> tuple[float, float]:
        """Return its lateral position in lanes (0 the rightmost) and the rate of it, 1/s."""
        if self.done is None:
            return float(self.lane), 0.0
        change = self.done
        share, rate = smooth_step((t_s - change.start_s) / change.last_s)
        step = change.to_lane - change.from_lane
        return change.from_lane + step * share, step * rate / change.last_s


@dataclass(frozen=True)
class Arrival:
    """The time, s, at which a vehicle wants to enter a lane, and the vehicle."""

    time_s: float
    driver: Driver = field(compare=False)


class TrafficFlow:
    """
    Traffic on the road, simulated step by step.

    :param config: the traffic.
    :param window_m: start and end of the measured part of each lane, counted from its entry.
    :param leave_m: position at which vehicles are removed, for each lane.
    :param rng: source of randomness.

    ``time_s`` is the current time; ``drivers`` are the vehicles on the road.
    """

    def __init__(self, config: TrafficConfig, window_m: dict[int, tuple[float, float]],
                 leave_m: dict[int, float], rng: np.random.Generator) -> None:
        self.config, self.leave_m = config, leave_m
        self.drivers: list[Driver] = []
        self._queues: dict[int, list[Arrival]] = {lane: [] for lane in leave_m}
        for arrival in _arrivals(config, window_m, rng):
            self._queues[arrival.driver.lane].append(arrival)
        self.time_s = min([q[0].time_s for q in self._queues.values() if q], default=0.0) - STEP_S

    def advance(self, t_s: float) -> None:
        """Advance all vehicles to a time, s, not before the current one."""
        while t_s - self.time_s >= STEP_S:
            self._step()

    def place(self, driver: Driver, t_s: float) -> tuple[float, float]:
        """Return position of the front, m, and speed, m/s, at a time within a step from now."""
        dt = t_s - self.time_s
        if driver.a_mps2 < 0:  # nobody drives backwards
            dt = min(dt, driver.v_mps / -driver.a_mps2)
        return (driver.x_m + driver.v_mps * dt + driver.a_mps2 * dt * dt / 2,
                driver.v_mps + driver.a_mps2 * dt)

    def _step(self) -> None:
        now = self.time_s + STEP_S
        for driver in self.drivers:
            driver.x_m, driver.v_mps = self.place(driver, now)
        self.time_s = now
        self.drivers = [d for d in self.drivers if d.x_m < self.leave_m[d.lane]]
        for lane, queue in self._queues.items():
            if queue and queue[0].time_s <= now and self._room(queue[0].driver):
                self.drivers.append(queue.pop(0).driver)
        for driver in self.drivers:
            self._steer(driver)
        for driver in self.drivers:
            driver.a_mps2 = self._acceleration(driver)

    def _leader(self, driver: Driver, lanes: tuple[int, ...]) -> Optional[Driver]:
        """Return the next vehicle ahead in some lanes of the same direction."""
        ahead = [d for d in self.drivers if d is not driver and d.x_m > driver.x_m
                 and set(d.lanes(self.time_s)) & set(lanes)]
        return min(ahead, key=lambda d: d.x_m - d.body.length_m, default=None)

    def _room(self, driver: Driver) -> bool:
        """Return whether a vehicle can enter behind the last one; set its speed accordingly."""
        driver.v_mps = driver.cruise_mps
        leader = self._leader(driver, (driver.lane,))
        if leader is None:
            return True
        driver.v_mps = min(driver.cruise_mps, leader.v_mps + 1.0)
        gap = leader.x_m - leader.body.length_m
        return gap > STANDING_M + 1.1 * driver.headway_s * driver.v_mps

    def _acceleration(self, driver: Driver) -> float:
        """Return the acceleration by the intelligent driver model, or less if so planned."""
        wish, eager = driver.cruise_mps, driver.eager_mps2
        planned: Optional[float] = None
        if driver.event is not None and driver.x_m >= driver.event[0]:
            _, planned, until = driver.event
            if (driver.v_mps - until) * np.sign(planned) >= 0:
                driver.event, planned = None, None
        if planned is not None and planned > 0:
            wish, eager = 1.6 * wish, planned
        free = 1 - (driver.v_mps / wish) ** 4 if planned is None else 1.0
        leader = self._leader(driver, driver.lanes(self.time_s))
        crowd = 0.0
        if leader is not None:
            gap = max(leader.x_m - leader.body.length_m - driver.x_m, 0.1)
            closing = driver.v_mps * (driver.v_mps - leader.v_mps)
            wanted = STANDING_M + max(
                0.0, driver.v_mps * driver.headway_s
                + closing / (2 * np.sqrt(driver.eager_mps2 * COMFORT_MPS2)))
            crowd = (wanted / gap) ** 2
        value = eager * (free - crowd)
        if planned is not None and planned < 0:
            value = min(value, planned)
        if driver.v_mps <= 0 and value < 0:
            return 0.0
        return float(np.clip(value, -HARDEST_MPS2, HARDEST_MPS2))

    def _steer(self, driver: Driver) -> None:
        """Start the planned lane change when there is room."""
        if driver.change is None or driver.x_m < driver.change[0]:
            return
        place, last_s, step = driver.change
        to = driver.lane + step
        if driver.x_m > place + CHANGE_TRIES_M:
            driver.change = None
            return
        for other in self.drivers:
            if other is driver or to not in other.lanes(self.time_s):
                continue
            ahead = other.x_m - other.body.length_m - driver.x_m
            behind = driver.x_m - driver.body.length_m - other.x_m
            if ahead < 4.0 + 0.8 * driver.v_mps and behind < 4.0 + 1.0 * other.v_mps:
                return
        driver.done = Change(self.time_s, last_s, driver.lane, to)
        driver.change = None


def _arrivals(config: TrafficConfig, window_m: dict[int, tuple[float, float]],
              rng: np.random.Generator) -> list[Arrival]:
    """Draw all vehicles, in the order in which they want to enter."""
    lanes = np.array(sorted(window_m))
    share = np.array([config.lane_shares[k] for k in lanes], dtype=float)
    until = max(config.minutes * 60 - config.clear_s, 1.0)
    times = np.sort(rng.uniform(-config.before_s, until, config.vehicles))
    out: list[Arrival] = []
    previous: dict[int, float] = {}
    for number, time_s in enumerate(times):
        lane = int(rng.choice(lanes, p=share / share.sum()))
        if previous and rng.random() < config.follow_share:
            # Right behind another vehicle: the position in the queue determines the headway.
            lane = int(rng.choice(sorted(previous)))
            time_s = previous[lane] if time_s - previous[lane] < 20.0 else time_s
        previous[lane] = float(time_s)
        out.append(Arrival(float(time_s), _driver(config, number, lane, window_m[lane], rng)))
    return sorted(out, key=lambda a: (a.time_s, a.driver.number))


def _driver(config: TrafficConfig, number: int, lane: int, window_m: tuple[float, float],
            rng: np.random.Generator) -> Driver:
    """Draw a vehicle and its planned behaviour."""
    body = config.draw_body(rng)
    cruise = float(np.clip(rng.normal(config.lane_speeds_mps[lane], config.speed_std_mps),
                           8.0, 45.0))
    first, last = window_m
    event = change = None
    draw = rng.random(2)
    place, strength = rng.uniform(first, last - 15.0), rng.uniform(0.15, config.hardest_g)
    if draw[0] < config.brake_share / 2:
        event = (place, -strength * G_MPS2, cruise * rng.uniform(0.45, 0.85))
    elif draw[0] < config.brake_share:
        event = (place, strength * G_MPS2, cruise * rng.uniform(1.1, 1.35))
    # Starts early enough to be in view.
    place, last_s = rng.uniform(first - 25.0, last - 25.0), rng.uniform(*config.change_s)
    steps = [k for k in (-1, 1) if config.same_way(lane, lane + k)]
    step = int(rng.choice(steps)) if steps else 0
    if steps and draw[1] < config.change_share:
        change = (place, last_s, step)
    return Driver(number, lane, body, cruise, rng.uniform(*config.headway_s),
                  rng.uniform(1.2, 2.5), event, change)
