# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated passes and their lanes, made once for all tests of the detector."""
from __future__ import annotations

from pathlib import Path
import sys
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.lab.sim.config import circle_config, RIGS, straight_config
from stereo_speed.lab.sim.sequence import simulate
from stereo_speed.lab.sim.traffic import TrafficStream
from stereo_speed.lab.sim.traffic_config import traffic_config
from stereo_speed.site.file import load_site
from stereo_speed.site.lane_paths import lane_paths
import yaml

cv2.setNumThreads(1)
sys.path.append(str(Path(__file__).parent))  # for drawn_fronts, which tests of units share


class Drive(NamedTuple):
    """A stream: rig, lanes, pairs, and the rows of its truth by stamp."""

    rig: StereoRig
    lanes: dict
    pairs: list
    truth: dict


def make_lanes(site, rig, folder):
    """Return the lanes of a site's content, through a real file."""
    path = folder / 'site.yaml'
    path.write_text(yaml.safe_dump(dict(site)))
    return lane_paths(load_site(path), rig)


def drive_of(config, seed, folder):
    """Simulate a pass; its lanes are those of picked lines."""
    sequence = simulate(config, np.random.default_rng(seed))
    truth = {}
    for row in sequence.truth:
        truth.setdefault(row['stamp_ns'], []).append(row)
    lanes = make_lanes(sequence.site, sequence.rig, folder)
    return Drive(sequence.rig, lanes, list(sequence.pairs), truth)


@pytest.fixture(scope='session')
def straight(tmp_path_factory):
    """55 mph on a straight road of two lanes."""
    config = straight_config('55 mph', pairs=5)
    return drive_of(config, 1, tmp_path_factory.mktemp('straight'))


@pytest.fixture(scope='session')
def distorted(tmp_path_factory):
    """36 mph on a circle of 41 m radius, through converging and distorted cameras."""
    config = circle_config('36 mph', 41.0, rig=RIGS['distorted'], pairs=4)
    return drive_of(config, 2, tmp_path_factory.mktemp('distorted'))


@pytest.fixture(scope='session')
def traffic(tmp_path_factory):
    """Two lanes, one receding, with people, trees, a parked car and a pole."""
    config = traffic_config('overcast', 2, 1, fps=5.0, minutes=0.1, vehicles=12)
    stream = TrafficStream(config, np.random.default_rng(4))
    pairs, truth = [], {}
    for one in stream:
        pairs.append(one.pair)
        truth[one.pair.stamp_ns] = one.truth
    lanes = make_lanes(stream.site, stream.rig, tmp_path_factory.mktemp('traffic'))
    return Drive(stream.rig, lanes, pairs, truth)


@pytest.fixture(scope='session')
def make_drive(tmp_path_factory):
    """Return the function that simulates a pass: (config, seed) to Drive."""
    return lambda config, seed: drive_of(config, seed, tmp_path_factory.mktemp('drive'))
