# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Roads drawn by closed forms, and simulated passes with inexact clicks and true lines."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Callable

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.special import ndtr
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.lab.sim.config import SimConfig
from stereo_speed.lab.sim.sequence import SimSequence, simulate
from stereo_speed.road.fitted import RoadFit
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.model import RoadModel
from stereo_speed.road.problem import Picks, RoadPrior, RoadProblem
from stereo_speed.site.file import LaneSpec, load_site, PickedLine, Site
from stereo_speed.site.lane_paths import lane_paths
from stereo_speed.site.refine.config import RefineConfig
from stereo_speed.site.refine.cross_sections import LineView
from stereo_speed.site.refine.empty_road import Background
from stereo_speed.site.refine.extrinsic_drift import decide_drift, FamilyDrift
from stereo_speed.site.refine.markings import locate
from stereo_speed.site.refine.refiner import RefinedSite
import yaml


@dataclass(frozen=True)
class Scene:
    """A simulated pass, its rough site and its exact lanes."""

    sequence: SimSequence
    site: Site
    exact: dict[str, LanePath]

    def off_px(self, name: str, uv_px: np.ndarray, right: bool) -> np.ndarray:
        """Return signed distances (n,) of pixels from a true line, as the rotated rig sees it."""
        scene = self.sequence.scene
        stations = np.arange(-60, scene.end_station_m + 40, 0.02)
        offset = np.full_like(stations, scene.road.line_offsets()[name])
        line = scene.to_left(scene.road.position(stations, offset))
        uv = scene.seen_rig.project(line)[int(right)]
        uv = uv[np.isfinite(uv).all(axis=-1)]
        near = np.clip(cKDTree(uv).query(uv_px)[1], 1, len(uv) - 2)
        along = uv[near + 1] - uv[near - 1]
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=-1)
        return np.sum((uv_px - uv[near]) * normal, axis=-1)


@pytest.fixture(scope='session')
def make_scene(tmp_path_factory) -> Callable[[SimConfig, int], Scene]:
    """Return a function that simulates a pass."""
    def make(config: SimConfig, seed: int) -> Scene:
        folder: Path = tmp_path_factory.mktemp('scene')
        sequence = simulate(config, np.random.default_rng(seed))
        for name, content in (('rough', sequence.site), ('exact', sequence.site_exact)):
            (folder / f'{name}.yaml').write_text(yaml.safe_dump(dict(content)))
        return Scene(sequence, load_site(folder / 'rough.yaml'),
                     lane_paths(load_site(folder / 'exact.yaml'), sequence.scene.seen_rig))
    return make


F_PX, HEIGHT_M, NEAR_M, FAR_M = 900.0, 3.0, 12.0, 45.0
CENTRE_PX = (319.5, 60.0)  # the horizon is near the top
LINES_M = {'right': -2.0, 'left': 1.5}  # x of the lines; they come straight nearer
WIDTH_M, BLUR_PX, ASPHALT, PAINT = 0.15, 0.7, 80.0, 180.0
FRAME = np.array([[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]])


class DrawnRoad:
    """
    A level straight road with two markings, drawn by closed forms and seen by a parallel rig.

    :param off_m: error to the left of the known road.
    """

    def __init__(self, off_m: float = 0.0) -> None:
        k = np.array([[F_PX, 0, CENTRE_PX[0]], [0, F_PX, CENTRE_PX[1]], [0, 0, 1.0]])
        cameras = [Camera(n, 640, 360, k, np.zeros(0), 'plumb_bob') for n in ('left', 'right')]
        self.rig = StereoRig(*cameras, np.eye(3), np.array([-0.5, 0.0, 0.0]))
        z = np.linspace(FAR_M, NEAR_M, 12)
        self.lines = {name: PickedLine(name, *(self.line(name, z, right) for right in (0, 1)))
                      for name in LINES_M}
        half = (FAR_M - NEAR_M) / 2
        model = RoadModel(FRAME, np.array([0, HEIGHT_M, NEAR_M + half]), half, 2)
        picks = Picks.of({name: line.views_px for name, line in self.lines.items()})
        self.fit = RoadFit(RoadProblem(self.rig, picks, model), np.array(
            [0, 0, 0, 0, *(x + off_m for x in LINES_M.values())]), 0.0)
        self.site = Site('site.yaml', 'drawn', self.lines, (
            LaneSpec('lane', 'right', 'left', None, 25.0),))

    def line(self, name: str, z: np.ndarray, right: int) -> np.ndarray:
        """Return the pixels (n, 2) of a line at depths (n,)."""
        points = np.stack([np.full_like(z, LINES_M[name]), np.full_like(z, HEIGHT_M), z], axis=-1)
        return self.rig.project(points)[right]

    def image(self, right: int, *, width_m: float = WIDTH_M, period_m: float = 0.0,
              noise: float = 0.0, seed: int = 0) -> np.ndarray:
        """
        Draw a view: bands of a width, or with width 0 kerbs that are lighter to the left.

        :param period_m: of a dash and its gap, of equal length; 0 for no gaps.
        """
        v, u = np.indices((360, 640)).astype(float)
        below = v > CENTRE_PX[1] + 1
        z = np.where(below, F_PX * HEIGHT_M / np.where(below, v - CENTRE_PX[1], 1.0), 1e4)
        x = (u - CENTRE_PX[0]) * z / F_PX + 0.5 * right
        blur = BLUR_PX * z / F_PX
        share = np.zeros_like(x)
        for place in LINES_M.values():
            if width_m:
                share += ndtr((x - place + width_m / 2) / blur) - ndtr(
                    (x - place - width_m / 2) / blur)
            else:
                share += ndtr((x - place) / blur) / len(LINES_M)
        if period_m:
            share *= ndtr(np.sin(2 * np.pi * z / period_m) * period_m / (2 * np.pi) / (
                blur * z / HEIGHT_M))
        grey = np.where(below, ASPHALT + (PAINT - ASPHALT) * share, 60.0)
        return grey + noise * np.random.default_rng(seed).standard_normal(grey.shape)

    def view(self, name: str, right: int, image: np.ndarray, noise: float = 1.0) -> LineView:
        """Return a line in a drawn view."""
        return LineView(self.fit, self.fit.number(name), bool(right),
                        Background(image.astype(np.float32), noise, 9))

    def off_px(self, name: str, uv_px: np.ndarray, right: int) -> np.ndarray:
        """Return signed distances (n,) of pixels from a line, which is straight in the image."""
        a, b = self.line(name, np.array([FAR_M, NEAR_M]), right)
        along = (b - a) / np.linalg.norm(b - a)
        return (uv_px - a) @ np.array([-along[1], along[0]])


@pytest.fixture(scope='session')
def draw() -> Callable[[float], DrawnRoad]:
    """Return a function that makes a road with a given error of its prior knowledge."""
    return DrawnRoad


@pytest.fixture(scope='session')
def drawn() -> DrawnRoad:
    """Return a road that is known exactly."""
    return DrawnRoad()


@pytest.fixture(scope='session')
def drawn_off() -> DrawnRoad:
    """Return a road that is known to 8 cm: 2 to 6 px in the images."""
    return DrawnRoad(0.08)


@pytest.fixture(scope='session')
def drawn_refined(drawn) -> RefinedSite:
    """Return the refined site of a drawn road with a dashed right line, found in both views."""
    views = tuple(Background(drawn.image(right, period_m=8.0).astype(np.float32), 1.0, 9)
                  for right in (0, 1))
    found = {name: tuple(
        locate(LineView(drawn.fit, i, bool(right), views[right]),
               drawn.lines[name].views_px[right][[0, -1]]) for right in (0, 1))
             for i, name in enumerate(LINES_M)}
    drift = decide_drift(
        [FamilyDrift(0.0, np.zeros(3), np.diag(np.radians([0.001, 0.0003, 0.002])**2))])
    return RefinedSite(drawn.site, drawn.rig, lane_paths(drawn.site, drawn.rig), drawn.site, found,
                       drawn.fit, drift, None, views, RefineConfig(), RoadPrior())
