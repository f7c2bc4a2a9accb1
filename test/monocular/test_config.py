# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the monocular tracker: loading, running, and effect."""
from __future__ import annotations

from dataclasses import asdict, fields, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_speed.core.config import load_config
from stereo_speed.core.errors import InputError
from stereo_speed.monocular.boxes import Target
from stereo_speed.monocular.config import MonocularConfig
from stereo_speed.monocular.distance import DistanceField
from stereo_speed.monocular.tracker import MonocularTracker
import yaml

ROOT = Path(__file__).resolve().parents[2]
FEW = MonocularConfig(particles=20)
PARAMETERS = {f.name: f for f in fields(MonocularConfig)}
PLAIN_ONLY = ('size_noise', 'size_rate_noise')
# bounds that would take long, or that another parameter narrows
NEARER_BOUND = {('particles', 'high'): 100, ('prior_rounds', 'high'): 40,
                ('samples_down', 'low'): FEW.parts}
WIDTH, HEIGHT, FRAMES = 120, 96, 12


def test_config_round_trips(tmp_path):
    path = tmp_path / 'file.yaml'
    path.write_text('{}')
    assert load_config(path, MonocularConfig) == MonocularConfig()
    path.write_text('particles: 300\nprior_noise: 0.1\ncovering: false\n')
    assert load_config(path, MonocularConfig) == MonocularConfig(
        particles=300, prior_noise=0.1, covering=False)


def test_shipped_files_hold_the_defaults_of_every_parameter():
    flat = yaml.safe_load((ROOT / 'config' / 'environment.yaml').read_text())
    assert flat == asdict(MonocularConfig())
    node = yaml.safe_load((ROOT / 'config' / 'environment.params.yaml').read_text())
    values = node['/**/environment_node']['ros__parameters']
    assert {name: values[name] for name in PARAMETERS} == asdict(MonocularConfig())


@pytest.mark.parametrize(('text', 'found'), [
    ('particles: 5', 'particles: found 5'), ('lambda_c: 1', 'key: found lamb'),
    ('- 1', 'top level: found list'), ('a: [', 'file: found'),
    ('prior_noise: .nan', 'prior_noise'), ('particles: many', 'particles'),
    ('covering: 2', 'covering: found 2'),
    ('parts: 4\nsamples_down: 3', 'samples_down: found 3, wanted at least one for each of the 4')])
def test_invalid_values_are_refused(tmp_path, text, found):
    path = tmp_path / 'file.yaml'
    path.write_text(text)
    with pytest.raises(InputError, match=rf'file\.yaml: {found}'):
        load_config(path, MonocularConfig)


def test_likelihood_of_the_paper_does_not_change_the_motion():
    paper = MonocularConfig(stop_chance=0.2, particles=77).with_paper_likelihood()
    changed = {f.name for f in fields(paper) if getattr(paper, f.name) != f.default}
    assert changed == {'stop_chance', 'particles', 'surround_weight', 'contrast_weight', 'parts',
                       'background_contrast', 'covering'}


class Crowd:
    """
    People of one colour on textured ground, for whom every parameter has an effect.

    1 walks in front; 2 walks behind, half occluded by 1 when marked, and vanishes for a while; 3
    walks out of the image; 4 stands until it is marked in frame 5; 5 is a box that rotates.
    """

    def __init__(self):
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        labels = np.where(np.abs(rows - 60 - 0.2 * columns) < 18, 255, 128).astype(np.uint8)
        labels[:12] = 0
        self.field = DistanceField(labels)
        noise = np.random.default_rng(0).normal(110, 25, (HEIGHT, WIDTH, 3))
        self.ground = cv2.GaussianBlur(noise, (0, 0), 1.0)
        self.targets = [
            Target(id=i, frame=frame, box_px=np.array(self.box(i, frame)),
                   angle_rad=0.4 if i == 5 else 0.0)
            for i, frame in enumerate((1, 1, 1, 5, 1), 1)]
        self.images = [self.image(n) for n in range(1, FRAMES + 1)]

    def box(self, number, frame):
        """Return x, y, w, h of a person in a frame."""
        x, y, w, h, step = {1: (20, 40, 10, 28, 2.5), 2: (26, 36, 10, 26, 2.0),
                            3: (96, 50, 10, 28, 2.5), 4: (60, 22, 8, 22, 1.5),
                            5: (10, 76, 16, 8, 2.0)}[number]
        start = 5 if number == 4 else 1
        return x + step * max(frame - start, 0), y, w, h

    def image(self, frame):
        """Draw a frame."""
        image = self.ground.copy()
        for number, colour in ((4, (200, 60, 30)), (2, (40, 40, 210)), (1, (40, 40, 210)),
                               (3, (40, 40, 210)), (5, (30, 170, 60))):
            x, y, w, h = self.box(number, frame)
            if number != 2 or not 6 <= frame <= 9:
                top, middle = int(y), int(y + h / 2)
                image[top:middle, int(x):int(x + w)] = colour
                image[middle:int(y + h), int(x):int(x + w)] = (20, 20, 20)
        image += np.random.default_rng(frame).normal(0, 3, image.shape)
        return np.clip(image, 0, 255).astype(np.uint8)

    def run(self, config, tracker='environment', frames=FRAMES):
        """Yield the boxes (n, 6) of all targets in each frame, with number and angle."""
        tracked = MonocularTracker(self.field, self.targets, config, tracker=tracker)
        for number, image in enumerate(self.images[:frames], 1):
            yield np.array([[e.id, *e.box_px, e.angle_rad]
                            for e in tracked.process(number, image)]).reshape(-1, 6)


@pytest.fixture(scope='module')
def crowd():
    """Return the people."""
    return Crowd()


@pytest.fixture(scope='module')
def boxes(crowd):
    """Return the results of the two trackers with every parameter at its default."""
    return {tracker: list(crowd.run(FEW, tracker)) for tracker in ('environment', 'plain')}


def bound(name, side):
    """Return the minimum (low) or maximum (high) valid value of a parameter."""
    default = PARAMETERS[name].default
    if isinstance(default, bool):
        return side == 'high'
    return NEARER_BOUND.get((name, side), PARAMETERS[name].metadata[side])


@pytest.mark.parametrize('name', PARAMETERS)
def test_every_parameter_changes_the_boxes(crowd, boxes, name):
    """At one of its bounds at least; that it runs at both is tested below."""
    tracker = 'plain' if name in PLAIN_ONLY else 'environment'
    changed = (replace(FEW, **{name: bound(name, side)}) for side in ('low', 'high'))
    assert any(not np.array_equal(found, usual) for config in changed  # until the first that does
               for found, usual in zip(crowd.run(config, tracker), boxes[tracker]))


@pytest.mark.parametrize('seed', range(8))
def test_every_valid_config_runs(crowd, seed):
    """Each parameter is drawn between its bounds or put on one of them."""
    rng = np.random.default_rng(seed)
    values = {}
    for name, f in PARAMETERS.items():
        low, high = bound(name, 'low'), bound(name, 'high')
        value = [low, high, low + rng.random() * (high - low)][rng.integers(3)]
        values[name] = type(f.default)(value)
    config = MonocularConfig(**{**values, 'particles': 20, 'samples_down': 6})
    for tracker in ('environment', 'plain'):
        found = np.concatenate(list(crowd.run(config, tracker, frames=6)))
        assert len(found) > 0 and np.isfinite(found).all() and (found[:, 3:5] > 0).all()
