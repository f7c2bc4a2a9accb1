# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated passes with rough clicks, and how far points lie from the true lines."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Callable

import numpy as np
import pytest
from scipy.spatial import cKDTree
from stereo_speed.lab.sim.config import SimConfig
from stereo_speed.lab.sim.sequence import SimSequence, simulate
from stereo_speed.road.lanes import LanePath
from stereo_speed.site.file import load_site, Site
from stereo_speed.site.lane_paths import lane_paths
import yaml


@dataclass(frozen=True)
class Scene:
    """A simulated pass, its rough site and its exact lanes."""

    sequence: SimSequence
    site: Site
    exact: dict[str, LanePath]

    def off_px(self, name: str, uv_px: np.ndarray, right: bool) -> np.ndarray:
        """Signed distances (n,) of pixels from a true line, as the turned rig sees it."""
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
    """Give the function that simulates a pass."""
    def make(config: SimConfig, seed: int) -> Scene:
        folder: Path = tmp_path_factory.mktemp('scene')
        sequence = simulate(config, np.random.default_rng(seed))
        for name, content in (('rough', sequence.site), ('exact', sequence.site_exact)):
            (folder / f'{name}.yaml').write_text(yaml.safe_dump(dict(content)))
        return Scene(sequence, load_site(folder / 'rough.yaml'),
                     lane_paths(load_site(folder / 'exact.yaml'), sequence.scene.seen_rig))
    return make
