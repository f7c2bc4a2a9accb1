# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Backgrounds: traffic removed, noise averaged."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.records import StereoPair
from stereo_speed.site.refine.empty_road import (
    as_picture, backgrounds, clean_background, MOST_BYTES, spread_pairs)


def images(count, rng, noise=2.0, scale=1, dtype=np.uint8):
    """Make noisy images of a ramp with a bright block that moves in each."""
    still = np.tile(np.linspace(60, 120, 160), (120, 1))
    out = []
    for i in range(count):
        image = still + noise * rng.standard_normal(still.shape)
        image[40:60, 10 * i:10 * i + 12] = 230
        out.append(np.rint(np.clip(np.rint(image), 0, 255) * scale).astype(dtype))
    return still, out


@pytest.mark.parametrize('scale, dtype', [(1, np.uint8), (257, np.uint16)])
def test_traffic_is_removed_and_noise_averaged(scale, dtype):
    still, found = images(12, np.random.default_rng(0), scale=scale, dtype=dtype)
    background = clean_background(found, 'test')
    off = background.image - still
    assert np.abs(off).max() < 5
    # better than the median, whose noise is 1.25 times that of the mean
    assert off.std() < 1.15 * np.hypot(2.0, 1 / np.sqrt(12)) / np.sqrt(12)
    assert 1.6 < background.noise_grey < 2.6
    assert background.pairs == 12 and as_picture(background).dtype == np.uint8


@pytest.mark.parametrize('bits', [10, 12, 14])
def test_cameras_of_other_bits_give_the_same_background(bits):
    wanted, found = (clean_background(images(12, np.random.default_rng(0), scale=scale,
                                             dtype=dtype)[1], 'test')
                     for scale, dtype in ((1, np.uint8), (((1 << bits) - 1) / 255, np.uint16)))
    assert np.abs(found.image - wanted.image).mean() < 0.1
    assert found.noise_grey == pytest.approx(wanted.noise_grey, rel=0.1)


def test_both_views_have_one_scale_of_grey_levels():
    """The right one of a camera pair of 12 bits sees nothing that is bright."""
    dark, bright = np.full((8, 8), 900, np.uint16), np.full((8, 8), 900, np.uint16)
    bright[:2] = 4000
    left, right = backgrounds([StereoPair(k, k, k, bright, dark) for k in range(3)])
    assert left.image[5, 5] == right.image[5, 5] == pytest.approx(900 * 255 / 4095)


def test_sweeping_light_is_separated_from_traffic_and_exposure():
    """A lamp's light grows from 100 to 190; every other exposure is 15 % longer."""
    rng = np.random.default_rng(3)
    still, _ = images(1, rng)
    _, found = images(15, rng)
    exposed = []
    for i, image in enumerate(found):
        image = image.astype(float)
        image[80:100, 20:140] = 100 + 6 * i
        exposed.append(np.clip(np.rint(image * (1.0, 1.15)[i % 2]), 0, 255).astype(np.uint8))
    background = clean_background(exposed, 'test')
    assert background.change.shape == (60, 80)
    assert background.change[40:50, 10:70].min() > 0.1
    elsewhere = background.change.copy()
    elsewhere[39:51, 9:71] = 0
    assert elsewhere.max() == 0  # the block that passes among it
    assert clean_background(exposed[:4], 'test').change is None


def test_two_images_with_different_content():
    still, found = images(2, np.random.default_rng(1))
    assert np.isfinite(clean_background(found, 'test').image).all()


def test_noise_is_estimated_from_one_image():
    still, found = images(1, np.random.default_rng(2))
    assert 1.7 < clean_background(found, 'test').noise_grey < 2.4


def test_no_images_are_refused():
    with pytest.raises(InputError, match='pairs: found none'):
        backgrounds([], 'bag')


@pytest.mark.parametrize('count', [1, 5, 31, 32, 62, 63, 400])
def test_pairs_are_spread_over_the_stream(count):
    image = np.zeros((4, 4), np.uint8)
    kept = [p.index for p in spread_pairs(
        StereoPair(i, i, i, image, image) for i in range(count))]
    assert len(kept) == min(count, 31) and kept[0] == 0
    assert kept == sorted(set(kept)) and kept[-1] >= 0.9 * (count - 1)
    if len(kept) > 2:
        steps = np.diff(kept)
        assert steps.max() <= 2 * steps.min()


@pytest.mark.parametrize(('images', 'wanted'), [(5, 5), (1, 2)])
def test_large_images_lower_the_number_of_pairs(images, wanted):
    """The images of a view fit into the limit; two pairs are kept in any case."""
    image = np.broadcast_to(np.zeros((), np.uint8), (MOST_BYTES // images, 1))
    kept = [p.index for p in spread_pairs(
        StereoPair(i, i, i, image, image) for i in range(40))]
    assert len(kept) == wanted and kept[0] == 0
    assert kept[-1] >= 0.75 * 39
