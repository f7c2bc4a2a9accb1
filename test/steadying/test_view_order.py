# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Swapped cameras are detected in the images; so are cameras that show nothing."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.io.bags import StereoBag
from stereo_speed.steadying.view_order import views_crossed


@pytest.fixture(scope='module')
def first(sample):
    """Return the rig and the first pair of the sample."""
    with StereoBag(sample / 'bag') as bag:
        return bag.rig, next(iter(bag.pairs()))


def test_cameras_in_their_places(first):
    rig, pair = first
    assert views_crossed(rig, pair) is False


def test_swapped_cameras(first):
    rig, pair = first
    assert views_crossed(rig, replace(pair, left=pair.right, right=pair.left)) is True


def test_empty_images_give_no_evidence(first):
    rig, pair = first
    empty = np.zeros_like(pair.left)
    assert views_crossed(rig, replace(pair, left=empty, right=empty)) is None


def test_noise_gives_no_evidence(first):
    rig, pair = first
    left, right = np.random.default_rng(0).integers(0, 255, (2, *pair.left.shape)).astype(np.uint8)
    assert views_crossed(rig, replace(pair, left=left, right=right)) is None
