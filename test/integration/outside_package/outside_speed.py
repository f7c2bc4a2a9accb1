# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A tracker and a detector that return scripted motion and detections."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from stereo_speed.core.config import parameter
from stereo_speed.core.passes import PassResult, TrackEnd, Verdict
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.detection.protocol import Detection
from stereo_speed.tracking.protocol import Refusal

FRONT_M = np.array([[-0.9, 0.8], [0.9, 0.8], [0.9, 0.0], [-0.9, 0.0]])  # to the right, and up


def front_quads(rig, lane, s_m):
    """Return the corners (4, 2) of a front on a lane's path, in both raw views."""
    at = np.array(s_m)
    right, up = -lane.path.frame(at)[:, 1], lane.path.frame(at)[:, 2]
    corners = lane.path.position(at) + FRONT_M[:, :1] * right + FRONT_M[:, 1:] * up
    return rig.project(corners)[:2]


@dataclass(frozen=True)
class ClockSettings:
    """Parameters of the tracker."""

    speed_mps: float = parameter(10.0, 1.0, 90.0, 'm/s', 'speed of every vehicle')


class ClockTracker:
    """Moves its front along the path of its lane at a configured speed."""

    Settings = ClockSettings

    @classmethod
    def start(cls, start, settings):
        """Return a tracker, or the reason why there is none."""
        if start.front.left_px[:, 1].max() < 0:
            return Refusal('outside', 'front', 'above the image', 'in it')
        return cls(start, settings)

    def __init__(self, start, settings):
        self.rig, self.lane, self.track = start.rig, start.lane, start.track
        self.speed_mps = settings.speed_mps
        self.first_ns = start.pair.stamp_ns
        front = start.front
        self.s_m = float(self.lane.path.arc_length(
            self.rig.triangulate(front.left_px.mean(axis=0), front.right_px.mean(axis=0))))
        self.stamps_ns = []
        self.ended = False

    def update(self, pair):
        """Advance by the elapsed time."""
        s_m = self.s_m + self.speed_mps * (pair.stamp_ns - self.first_ns) * 1e-9
        left, right = front_quads(self.rig, self.lane, s_m)
        if not (np.isfinite(left).all() and self.rig.left.inside(left).all()):
            self.ended = True
            return None
        self.stamps_ns.append(pair.stamp_ns)
        confirmed = len(self.stamps_ns) > 2
        return TrackUpdate(
            stamp_ns=pair.stamp_ns, track=self.track, lane=self.lane.name,
            state=TrackState.CONFIRMED if confirmed else TrackState.TENTATIVE,
            speed_mps=self.speed_mps, speed_std_mps=0.1, s_m=s_m, lateral_m=0.0,
            position_m=self.lane.path.position(np.array(s_m)), position_cov_m2=np.eye(3),
            axes=self.lane.path.frame(np.array(s_m)), quad_left_px=left, quad_right_px=right)

    def result(self):
        """Return the speed of the parameter."""
        return PassResult(
            track=self.track, lane=self.lane.name, first_ns=self.stamps_ns[0],
            last_ns=self.stamps_ns[-1], pairs=len(self.stamps_ns), speed_mps=self.speed_mps,
            speed_std_mps=0.1, verdict=Verdict.MEASURED, reason='',
            smoothed=dict.fromkeys(self.stamps_ns, self.speed_mps),
            smoothed_std=dict.fromkeys(self.stamps_ns, 0.1),
            end=TrackEnd.LEFT_VIEW if self.ended else TrackEnd.STREAM_ENDED)


@dataclass(frozen=True)
class GateSettings:
    """Parameters of the detector."""

    gate_m: float = parameter(20.0, 0.0, 500.0, 'm', 'where it finds a vehicle, along the path')
    at_pair: int = parameter(2, 0, 1000, '', 'in which pair')


class GateDetector:
    """Finds one vehicle, in a pair and at a position that are parameters."""

    Settings = GateSettings

    def __init__(self, rig, lanes, settings):
        self.rig, self.lane, self.settings = rig, next(iter(lanes.values())), settings
        self.pairs = 0

    def reset(self):
        """Start again."""
        self.pairs = 0

    def update(self, pair, tracked):
        """Return the vehicle in its pair."""
        self.pairs += 1
        if self.pairs != self.settings.at_pair + 1:
            return []
        left, right = front_quads(self.rig, self.lane, self.settings.gate_m)
        return [Detection(lane=self.lane.name, left_px=left, right_px=right, std_px=0.5,
                          s_m=self.settings.gate_m, lateral_m=0.0, width_m=1.8, height_m=0.8)]
