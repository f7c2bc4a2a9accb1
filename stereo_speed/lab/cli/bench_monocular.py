# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Time the monocular tracker per target and frame, with and without the environment."""
from __future__ import annotations

import time

import cv2
import numpy as np
from numpy.typing import NDArray

from ...monocular.boxes import Target
from ...monocular.config import MonocularConfig
from ...monocular.distance import DistanceField
from ...monocular.tracker import MonocularTracker, TRACKERS

WIDTH, HEIGHT = 768, 576
_FRAMES = 30  # few enough that each target is in view in all of them
_BOX = (30, 80)  # size of a person, px
_STEP_PX = 4  # motion of a walking person per frame
_COLOURS = ((40, 40, 200), (200, 60, 30), (30, 170, 60), (20, 20, 20))


def synthetic_scene() -> tuple[DistanceField, list[Target], list[NDArray[np.uint8]]]:
    """Return plain-coloured people who walk along a road, on textured ground."""
    rows = np.arange(HEIGHT)
    labels = np.full((HEIGHT, WIDTH), 128, np.uint8)
    labels[(rows > 200) & (rows < 500)] = 255
    noise = np.random.default_rng(0).normal(120, 25, (HEIGHT, WIDTH, 3))
    ground = cv2.GaussianBlur(noise, (0, 0), 1.5).clip(0, 255).astype(np.uint8)
    corner = [(100, 150 + 90 * i) for i in range(len(_COLOURS))]
    images = []
    for frame in range(_FRAMES):
        image = ground.copy()
        for (x, y), colour in zip(corner, _COLOURS):
            x += _STEP_PX * frame
            image[y:y + _BOX[1], x:x + _BOX[0]] = colour
        images.append(image)
    targets = [Target(id=i + 1, frame=1, box_px=np.array([x, y, *_BOX], dtype=float))
               for i, (x, y) in enumerate(corner)]
    return DistanceField(labels), targets, images


def times_ms(tracker: str, particles: int, targets: int) -> list[float]:
    """Track, and return the CPU time of each frame after the first, per target, ms."""
    field, marked, images = synthetic_scene()
    tracked = MonocularTracker(field, marked[:targets], MonocularConfig(particles=particles),
                               tracker=tracker)
    times = []
    for number, image in enumerate(images, 1):
        start = time.process_time()
        found = tracked.process(number, image)
        times.append((time.process_time() - start) * 1e3 / max(len(found), 1))
    return times[1:]


def rows(rounds: int, particles: int = 150) -> dict[str, list[float]]:
    """Run the trackers in turns, and return the times of each, ms."""
    times: dict[str, list[float]] = {}
    for _ in range(rounds):
        for tracker in TRACKERS:
            for targets in (1, len(_COLOURS)):
                times.setdefault(f'{tracker}, {particles} particles, {targets} seen', []).extend(
                    times_ms(tracker, particles, targets))
    return times
