# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Two vehicles side by side, and a detector that finds them on request."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
from stereo_speed.core.config import NoParameters
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.detection.protocol import Detection
from stereo_speed.lab.sim import simulate, straight_config, VehicleConfig
from stereo_speed.pipeline.pipeline import SpeedPipeline
from stereo_speed.road.path import StraightPath
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
from stereo_speed.site.lane_paths import lane_paths
from stereo_speed.tracking.constrained import ConstrainedTracker
import yaml


def start(request):
    """Start a constrained tracker."""
    return ConstrainedTracker.start(request, NoParameters())


class ScriptedFinder:
    """Finds given fronts in given pairs; records the occupied regions."""

    def __init__(self, marks, lane, pairs):
        self.marks, self.lane, self.pairs, self.occupied = marks, lane, pairs, []
        self.earlier, self.speed_mps, self.std_share = None, 20.0, 0.05

    def update(self, pair, occupied):
        """Return the scripted fronts of this pair."""
        self.occupied.append(list(occupied))
        self.lag_s = pair.right_lag_s
        if pair.index not in self.pairs:
            return []
        return [Detection(lane=self.lane, left_px=m.left_px, right_px=m.right_px, std_px=0.7,
                          s_m=0.0, lateral_m=0.0, width_m=1.8, height_m=0.8,
                          speed_mps=self.speed_mps, speed_std_mps=self.std_share * self.speed_mps,
                          earlier=self.earlier)
                for m in self.marks]

    def reset(self):
        """Record the reset."""
        self.occupied.append('reset')


def two_abreast(folder, **changes):
    """Return a pass of two vehicles side by side, 45 and 50 mph, with its lanes and marks."""
    config = replace(straight_config('50 mph', **changes), vehicles=(
        VehicleConfig(speed_mps=22.352, lane=0), VehicleConfig(speed_mps=20.117, lane=1)))
    sequence = simulate(config, np.random.default_rng(1))
    (folder / 'site.yaml').write_text(yaml.safe_dump(dict(sequence.site_exact)))
    (folder / 'init.yaml').write_text(yaml.safe_dump(dict(sequence.init)))
    lanes = lane_paths(load_site(folder / 'site.yaml'), sequence.rig)
    return sequence, lanes, load_init(folder / 'init.yaml')


def automatic(scene, marks, pairs, config=TrackerConfig(), **more):
    """Return a pipeline that finds annotated fronts in some pairs of a scene, and its detector."""
    sequence, lanes, _ = scene
    finder = ScriptedFinder(marks, next(iter(lanes)), pairs)
    return SpeedPipeline(sequence.rig, lanes, config, start, detector=finder, **more), finder


def ending(scene, ahead_m):
    """Return a scene whose lanes end a way ahead of the first vehicle, where it leaves them."""
    sequence, lanes, marks = scene
    ends = {}
    for name, lane in lanes.items():
        begin = lane.path.position(np.array(0.0))
        s_m = float(lane.path.arc_length(sequence.rig.triangulate(
            marks[0].left_px.mean(axis=0), marks[0].right_px.mean(axis=0))))
        ends[name] = replace(lane, path=StraightPath(
            begin, lane.path.tangent(np.array(0.0)), s_m + ahead_m))
    return sequence, ends, marks


def project(sequence, mark, k, vehicle=0):
    """Move an annotation of pair 0 to pair k by the true motion of its vehicle."""
    places = [np.array([row[c] for c in 'xyz']) for pair in (sequence.pairs[0], sequence.pairs[k])
              for row in sequence.truth
              if row['stamp_ns'] == pair.stamp_ns and row['vehicle'] == vehicle]
    rig = sequence.rig
    corners = rig.triangulate(mark.left_px, mark.right_px)
    depth = places[0] - corners.mean(axis=0)  # depth error of the annotation
    return rig.project(corners + depth + places[1] - places[0])[:2]
