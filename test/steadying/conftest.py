# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""An infinitely distant textured world, seen by cameras that rotate."""
from __future__ import annotations

from functools import lru_cache
from typing import Callable, Optional

import numpy as np
from numpy.typing import NDArray
import pytest
from stereo_speed.core.records import RigMotion, StereoPair
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig

WIDTH, HEIGHT, F_PX = 512, 384, 800.0
NOISE_GREY = 2.0


def world(rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the grey values of directions (..., 3): waves of many lengths of some pixels."""
    rng = np.random.default_rng(5)
    x, y = np.moveaxis(rays[..., :2] / rays[..., 2:], -1, 0)
    out = np.full(x.shape, 125.0)
    # Short waves give precise places, long ones where to search.
    for low_px, high_px in 12 * [(9.0, 50.0)] + 4 * [(120.0, 300.0)]:
        length_px = rng.uniform(low_px, high_px)
        angle, phase = rng.uniform(0.0, 2 * np.pi, 2)
        wave = 2 * np.pi * F_PX / length_px
        out += 12.0 * np.sin(wave * (np.cos(angle) * x + np.sin(angle) * y) + phase)
    return out


@pytest.fixture(scope='session')
def rig() -> StereoRig:
    """Return cameras that are neither parallel nor free of distortion."""
    k = np.array([[F_PX, 0.0, (WIDTH - 1) / 2], [0.0, F_PX, (HEIGHT - 1) / 2], [0.0, 0.0, 1.0]])
    cameras = [Camera(name, WIDTH, HEIGHT, k, np.array([-0.2, 0.1, 1e-3, -1e-3]), 'plumb_bob')
               for name in ('left', 'right')]
    parallel = StereoRig(*cameras, np.eye(3), np.array([-0.5, 0.0, 0.0]))
    turned = parallel.drifted((0.02, 0.01, -0.01))
    return StereoRig(*cameras, turned.R, turned.t)


@pytest.fixture(scope='session')
def take(rig) -> Callable[..., StereoPair]:
    """Return a function that takes a pair."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    grid = np.stack([u, v], axis=-1)
    rays = [camera.rays(grid) for camera in (rig.left, rig.right)]

    @lru_cache(maxsize=None)
    def taken(index: int, motion: Optional[RigMotion] = None, *, gain: float = 1.0,
              noise: float = NOISE_GREY) -> StereoPair:
        """Take a pair of a rig that has moved, with independent noise, withholding the motion."""
        now = rig.as_taken(motion)
        turned = np.eye(3) if now.left.rotation is None else now.left.rotation
        rng = np.random.default_rng(index)
        views = [gain * world(r @ R) + rng.normal(0.0, noise, (HEIGHT, WIDTH))
                 for r, R in zip(rays, (turned, now.R))]
        left, right = (np.clip(np.rint(view), 0, 255).astype(np.uint8) for view in views)
        ns = index * 100_000_000
        return StereoPair(index, ns, ns, left, right)
    return taken
