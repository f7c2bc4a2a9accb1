# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A front whose images have a closed form, and simulated passes, rendered once for all tests."""
from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from stereo_speed.core.records import InitialFront, StereoPair
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.lab.sim.config import straight_config
from stereo_speed.lab.sim.sequence import simulate
from stereo_speed.pipeline.assembly import make_pipeline
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.pipeline.run import run
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
from stereo_speed.site.lane_paths import lane_paths
from stereo_speed.tracking.protocol import TrackStart
from stereo_speed.vision.encoding import light_blurred
import yaml

cv2.setNumThreads(1)

SECOND = 1_000_000_000
FOCAL_PX, BASELINE_M, FAR_M = 1500.0, 0.5, 60.0
HALF_M = np.array([0.9, 0.4])  # size of the front, across and up


def _camera(side):
    K = np.array([[FOCAL_PX, 0, 159.5], [0, FOCAL_PX, 119.5], [0, 0, 1]])
    return Camera(name=side, width_px=320, height_px=240, K=K, D=np.zeros(0), model='plumb_bob')


@dataclass(frozen=True)
class TexturedFront:
    """
    A textured plane that comes towards a rig along a straight path 2 m below its left camera.

    The texture is a sum of waves, so that its images have a closed form: at s, a, b the front's
    centre lies at (a, 2 - b, 60 - s), and it points to the left of its path by a heading.  What
    is behind it is grey.

    :param seed: of the texture.
    :param noise: 1-sigma of the images' noise, grey levels.
    :param mirrors: growth of what all but the upper quarter mirrors, per metre travelled.
    """

    seed: int = 0
    noise: float = 1.0
    mirrors: float = 0.0
    rig = StereoRig(left=_camera('left'), right=_camera('right'), R=np.eye(3),
                    t=np.array([-BASELINE_M, 0, 0]), frame_id='left')
    path = StraightPath(np.array([0.0, 2.0, FAR_M]), np.array([0.0, 0.0, -1.0]), 50.0)
    lane = LanePath('lane', path, 20.0, np.full(2, 1e-4), 0.1)
    corners_m = HALF_M * [[-1, 1], [1, 1], [1, -1], [-1, -1]]
    focal_px, baseline_m, far_m = FOCAL_PX, BASELINE_M, FAR_M

    def texture(self, x, y):
        """Return the grey levels at places on the front, m from its centre."""
        rng = np.random.default_rng(self.seed)
        waves = rng.uniform(-1, 1, (14, 2)) * 2 * np.pi / 0.2  # no wave is shorter than 0.14 m
        phases = rng.uniform(0, 2 * np.pi, 14)
        return 120 + sum(18 * np.sin(kx * x + ky * y + p) for (kx, ky), p in zip(waves, phases))

    def image(self, camera_x_m, pose, heading_rad, rng):
        """Return the view from a place beside the left camera."""
        u, v = np.meshgrid(np.arange(320) - 159.5, np.arange(240) - 119.5)
        u, v = u / FOCAL_PX, v / FOCAL_PX
        s, a, b = pose
        cos, sin = np.cos(heading_rad), np.sin(heading_rad)
        # Along the front (cos, 0, sin), out of it (sin, 0, -cos); the ray is (u, v, 1) depth.
        from_centre = np.array([camera_x_m - a, b - 2, s - FAR_M])
        depth = -(sin * from_centre[0] - cos * from_centre[2]) / (sin * u - cos)
        x = cos * (u * depth + from_centre[0]) + sin * (depth + from_centre[2])
        y = -(v * depth + from_centre[1])
        on_front = (np.abs(x) < HALF_M[0]) & (np.abs(y) < HALF_M[1])
        grey = 100.0 + self.noise * rng.standard_normal(u.shape)
        size = 1 + np.where(y < HALF_M[1] / 2, self.mirrors, 0.0) * (s - 20.0)
        grey[on_front] += self.texture((x / size)[on_front], (y / size)[on_front]) - 100.0
        return np.clip(np.rint(16 * grey), 0, 65535).astype(np.uint16)

    def pair(self, index, stamp_ns, pose, *, heading_rad=0.0, right_ns=None, right_pose=None):
        """Return the pair that shows the front at a pose, the right view maybe at another."""
        rng = np.random.default_rng([self.seed, index])
        left = self.image(0.0, pose, heading_rad, rng)
        right = self.image(BASELINE_M, pose if right_pose is None else right_pose, heading_rad,
                           rng)
        return StereoPair(index, stamp_ns, stamp_ns if right_ns is None else right_ns, left, right)

    @staticmethod
    def with_contrast(pair):
        """Return a pair of 12 bits with grey levels from nearly black to nearly white."""
        share = {side: getattr(pair, side) / 4095 for side in ('left', 'right')}
        return replace(pair, **{side: np.rint(3900 / (1 + np.exp(-9 * (at - 0.45)))).astype(
            np.uint16) for side, at in share.items()})

    @staticmethod
    def softened(pair, sigma_px, gamma):
        """Return a pair whose light is blurred, where its grey levels are a root of it."""
        return replace(pair, **{
            side: np.rint(light_blurred(getattr(pair, side).astype(np.float32), [sigma_px] * 2,
                                        gamma)).astype(np.uint16) for side in ('left', 'right')})

    def quads(self, pose):
        """Return the corners (4, 2) in both views, px."""
        s, a, b = pose
        corners = np.column_stack([a + self.corners_m[:, 0], 2 - b - self.corners_m[:, 1],
                                   np.full(4, FAR_M - s)])
        return self.rig.project(corners)[:2]

    def drive(self, count=12, fps=10.0, speed_mps=20.0, pose=(6.0, 0.1, 1.9)):
        """Return pairs of a vehicle at constant speed, and its poses (n, 3)."""
        times = np.arange(count) / fps
        poses = np.array(pose) + np.outer(times, [speed_mps, 0, 0])
        return [self.pair(k, round(t * SECOND), p)
                for k, (t, p) in enumerate(zip(times, poses))], poses

    def start(self, pair, pose, config=TrackerConfig(), seed=0, **changes):
        """Return what a track starts from, its quads exact."""
        left, right = self.quads(pose)
        begin = TrackStart(rig=self.rig, lane=self.lane, config=config,
                           front=InitialFront(pair.index, left, right), pair=pair, track=0,
                           rng=np.random.default_rng(seed))
        return replace(begin, **changes)


@pytest.fixture(scope='session')
def textured():
    """Return the front with a texture."""
    return TexturedFront()


@pytest.fixture(scope='session')
def textured_drive(textured):
    """Return twelve pairs at 20 m/s, 10 a second, and the poses (12, 3)."""
    return textured.drive()


@pytest.fixture(scope='session')
def straight():
    """55 mph on a straight road, with two pairs lost on the way."""
    return simulate(straight_config('55 mph', drop=(4, 5)), np.random.default_rng(1))


@pytest.fixture(scope='session')
def prepare(tmp_path_factory):
    """Return a function from a sequence to its lanes and first fronts, through real files."""
    def prepared(sequence):
        folder = tmp_path_factory.mktemp('prepared')
        (folder / 'site.yaml').write_text(yaml.safe_dump(dict(sequence.site_exact)))
        (folder / 'init.yaml').write_text(yaml.safe_dump(dict(sequence.init)))
        return (lane_paths(load_site(folder / 'site.yaml'), sequence.rig),
                load_init(folder / 'init.yaml'))
    return prepared


@pytest.fixture(scope='session')
def drive(prepare):
    """Return a function from a sequence to updates and passes; each default run is made once."""
    known = {}

    def driven(sequence, pairs=None, seed=0, config=TrackerConfig()):
        lanes, fronts = prepare(sequence)
        pipeline = make_pipeline(sequence.rig, lanes, PipelineConfig(config), fronts, seed=seed)
        done = run(pipeline, pairs or sequence.pairs)
        return done.updates, done.passes

    def once(sequence, pairs=None, seed=0, config=TrackerConfig()):
        key = (id(sequence), seed) if pairs is None and config == TrackerConfig() else None
        if key is None:
            return driven(sequence, pairs, seed, config)
        if key not in known:
            known[key] = sequence, driven(sequence, seed=seed)  # the sequence keeps its id
        return known[key][1]
    return once
