# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Equalising the sharpness of views, one of which is out of focus."""
from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from stereo_speed.lab.sim.config import straight_config
from stereo_speed.lab.sim.optics import FaultConfig
from stereo_speed.site.refine.empty_road import Background
from stereo_speed.site.refine.equal_sharpness import equally_sharp
from stereo_speed.site.refine.markings import LocatedLine
from stereo_speed.site.refine.refiner import refine_site
from stereo_speed.site.refine.section_model import Shape


def _line(blur_px):
    none = np.zeros(0)
    return LocatedLine(np.zeros((0, 2)), none, none, Shape('band', 0.15, blur_px, 1), 0.05, 9, 9)


def _lines(left_px, right_px):
    return [(_line(left), _line(right)) for left, right in zip(left_px, right_px)]


def _view(seed, blur_px=0.0):
    image = np.random.default_rng(seed).normal(100.0, 6.0, (120, 160)).astype(np.float32)
    if blur_px:
        image = cv2.GaussianBlur(image, (0, 0), blur_px)
    return Background(image, 6.0, 5)


@pytest.mark.parametrize('dull', [0, 1])
def test_sharper_view_gets_the_blur_of_the_other(dull):
    sharp, blurred = _view(1, 1.5), _view(1, 2.5)  # one scene through two lenses
    views = (blurred, sharp) if dull == 0 else (sharp, blurred)
    blurs = [2.5, 2.5, 2.5], [1.5, 1.5, 1.5]
    left, right = equally_sharp(views, _lines(*(blurs if dull == 0 else blurs[::-1])))
    inside = np.s_[12:-12, 12:-12]
    off = left.image[inside] - right.image[inside]
    assert np.std(off) < 0.03 * np.std((views[0].image - views[1].image)[inside])
    assert (left, right)[dull] is views[dull]


def test_noise_is_that_of_the_blurred_images():
    view = _view(2)
    left, _ = equally_sharp((view, view), _lines([0.5], [np.hypot(0.5, 2.0)]))
    assert left.noise_grey == pytest.approx(left.image[8:-8, 8:-8].std(), rel=0.1)


@pytest.mark.parametrize('blurs', [([], []), ([0.5], [0.55]), ([0.5, 0.5, 0.5], [0.5, 0.5, 2.0])])
def test_views_that_most_lines_show_alike_stay_unchanged(blurs):
    views = _view(3), _view(4)
    assert equally_sharp(views, _lines(*blurs)) is views


@pytest.mark.slow
def test_camera_out_of_focus_is_not_taken_for_rotated(make_scene):
    rig = replace(straight_config().rig, width_px=720, height_px=540, f_px=1250.0)
    scene = make_scene(straight_config(
        rig=rig, pairs=7, faults=FaultConfig(right_defocus_px=2.0)), 4)
    drift = refine_site(scene.site, scene.sequence.rig, scene.sequence.pairs).drift
    assert not drift.moved
    # As sure as with both cameras in focus; one in, one out left up to 0.006 degrees of roll.
    assert np.all(drift.std_rad < np.radians(0.0006))
