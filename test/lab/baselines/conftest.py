# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated passes for all baselines, and image-free track starts."""
from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from stereo_speed.core.records import InitialFront, StereoPair
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.lab.baselines.points import ExpectedFront, Points
from stereo_speed.lab.evaluation.experiments import EVERY_READING
from stereo_speed.lab.sim.config import DISTORTED, straight_config
from stereo_speed.lab.sim.sequence import simulate
from stereo_speed.pipeline.assembly import make_pipeline
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.pipeline.run import run as run_pipeline
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
from stereo_speed.site.lane_paths import lane_paths
from stereo_speed.tracking.front import Front
from stereo_speed.tracking.initialise import Placement
from stereo_speed.tracking.protocol import TrackStart
import yaml

cv2.setNumThreads(1)


@pytest.fixture(scope='session')
def straight():
    """Simulate 45 mph with distorted, converging cameras, uneven stamps and a lost pair."""
    config = straight_config('45 mph', rig=DISTORTED, start_m=50.0, stamp_jitter_s=0.02, drop=(5,))
    return simulate(config, np.random.default_rng(1))


@pytest.fixture(scope='session')
def drive(tmp_path_factory):
    """Run a tracker over a sequence, and return updates and the pass; whole passes run once."""
    known = {}

    def run(sequence, tracker, pairs=None, settings=None, **changes):
        folder = tmp_path_factory.mktemp('site')
        site, init = folder / 'site.yaml', folder / 'init.yaml'
        site.write_text(yaml.safe_dump(dict(sequence.site_exact)))
        init.write_text(yaml.safe_dump(dict(sequence.init)))
        changes = {'visibility': EVERY_READING, **changes}
        config = PipelineConfig(TrackerConfig(**changes), tracker,
                                trackers={} if settings is None else {tracker: settings})
        done = run_pipeline(
            make_pipeline(sequence.rig, lane_paths(load_site(site), sequence.rig), config,
                          load_init(init)), pairs or sequence.pairs)
        return done.updates, *done.passes

    def once(sequence, tracker, pairs=None, settings=None, **changes):
        if pairs is not None:
            return run(sequence, tracker, pairs, settings, **changes)
        key = id(sequence), tracker
        if key not in known:
            known[key] = run(sequence, tracker)
        return known[key]
    return once


@pytest.fixture(scope='session')
def parallel():
    """Two parallel cameras of 1800 px, half a metre apart."""
    k = np.array([[1800.0, 0, 511.5], [0, 1800.0, 383.5], [0, 0, 1]])
    cameras = [Camera(n, 1024, 768, k, np.zeros(0), 'plumb_bob') for n in ('left', 'right')]
    return StereoRig(*cameras, np.eye(3), np.array([-0.5, 0, 0]))


class Scene:
    """
    A front that approaches along a straight path at 20 m/s from 60 m away, without images.

    Its points and its first front are measured with Gaussian errors.
    :param rig: the cameras.
    :param seed: of all errors.
    :param std_px: matching error of the points in each view.
    :param changes: of the parameters that all trackers share.
    """

    speed_mps = 20.0
    corners_m = np.array([[-0.9, 0.4], [0.9, 0.4], [0.9, -0.4], [-0.9, -0.4]])

    def __init__(self, rig, seed=0, std_px=0.5, **changes):
        self.rig, self.std_px, self.rng = rig, std_px, np.random.default_rng(seed)
        path = StraightPath(np.array([1.0, 1.5, 80.0]), np.array([0.0, 0, -1]), 75.0,
                            np.array([0.0, -1, 0]))
        self.axes = path.frame(np.array(0.0))
        self.points_m = self.rng.uniform([-0.8, -0.3], [0.8, 0.3], (40, 2)) @ self.axes[:, 1:].T
        s_std_m = 1.0
        error = s_std_m * self.rng.standard_normal()
        centre = self.centre_m(0)
        slope = -(centre @ self.axes[:, 1:]) / centre[2]  # along the ray of the left camera
        pose = np.array([20.0 + error, *(error * slope)])
        self.placed = Placement(Front(path, self.corners_m), pose, s_std_m, slope, 0.25, 1.0)
        corners = centre + self.corners_m @ self.axes[:, 1:].T
        self.start = TrackStart(
            rig=rig, lane=LanePath('lane', path, self.speed_mps, np.zeros(2), 0.0),
            config=replace(TrackerConfig(), **changes),
            front=InitialFront(0, *rig.project(corners)[:2]), pair=self.pair(0), track=7,
            rng=self.rng)

    def centre_m(self, stamp_ns):
        """Return the position (3,) of the front's centre."""
        return np.array([1.0, 1.5, 60.0 - self.speed_mps * stamp_ns * 1e-9])

    @staticmethod
    def pair(index, dtype=np.uint8):
        """Return a pair of blank images, 5 pairs/s."""
        blank = np.zeros((2, 2), dtype)
        return StereoPair(index, 200_000_000 * index, 200_000_000 * index, blank, blank)

    def observe(self, pair, expected):
        """Return the points of the front, as a source does."""
        left, right, _, _ = self.rig.project(self.centre_m(pair.stamp_ns) + self.points_m)
        left, right = (uv + self.std_px * self.rng.standard_normal(uv.shape)
                       for uv in (left, right))
        keep = self.rng.random(len(left)) < 0.8
        return Points(np.flatnonzero(keep), left[keep], right[keep])

    def run(self, tracker, pairs=10):
        """Feed pairs to a tracker; return its updates."""
        return [tracker.update(self.pair(k)) for k in range(pairs)]


@pytest.fixture
def scene(parallel):
    """Return the function that makes scenes without images."""
    return lambda *args, **changes: Scene(parallel, *args, **changes)


class Textured:
    """A textured front in two pairs that moves between them by a known number of pixels."""

    disparity, motion = np.array([20.4, 0]), np.array([6.5, 4.0])
    quad = np.array([[200.0, 150], [300, 150], [300, 200], [200, 200]])

    @staticmethod
    def view(shift):
        """Return the texture moved by (2,) px."""
        rng = np.random.default_rng(0)
        texture = cv2.GaussianBlur(rng.uniform(0, 255, (384, 512)).astype(np.float32), (0, 0), 2.0)
        texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
        move = np.array([[1.0, 0, shift[0]], [0, 1, shift[1]]])
        moved = cv2.warpAffine(texture, move, (512, 384), flags=cv2.INTER_CUBIC,
                               borderMode=cv2.BORDER_REFLECT)
        return np.round(moved).clip(0, 255).astype(np.uint8)

    def __call__(self, source):
        """Return the points from a source in both pairs, which are a pixel off the expectation."""
        quad, right = self.quad, self.quad - self.disparity
        expected = (ExpectedFront(quad, right + [1.0, 0], quad, 2.0),
                    ExpectedFront(quad + self.motion + 1, right + self.motion, quad, 2.0))
        return [source.observe(StereoPair(k, k, k, self.view(m), self.view(m - self.disparity)), e)
                for k, (m, e) in enumerate(zip((np.zeros(2), self.motion), expected))]

    def check(self, first, second, tolerance_px):
        """Assert that the points have the disparity, and move as the texture does."""
        for found in (first, second):
            assert found.matched.sum() >= 20
            off = (found.left - found.right)[found.matched] - self.disparity
            assert np.median(np.abs(off)) < tolerance_px
        _, a, b = np.intersect1d(first.ids, second.ids, return_indices=True)
        assert len(a) >= 15
        assert np.median(np.abs(second.left[b] - first.left[a] - self.motion)) < tolerance_px


@pytest.fixture(scope='session')
def textured():
    """Show a textured front to a source of points."""
    return Textured()
