# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Colour images from messages, against OpenCV and by hand."""
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from stereo_speed.core.errors import BagError
from stereo_speed.io.colour import bgr_from_message, bgr_of_grey

COLOUR = {'bgr8': (3, None), 'rgb8': (3, 'RGB2BGR'), 'bgra8': (4, 'BGRA2BGR'),
          'rgba8': (4, 'RGBA2BGR')}


@pytest.mark.parametrize('padding', [0, 5])
@pytest.mark.parametrize('encoding', COLOUR)
def test_colour_equals_cvtcolor(bags, encoding, padding):
    channels, code = COLOUR[encoding]
    pixels = bags.picture(1, (12, 17, channels))
    for msgs in (bags.ros1, bags.ros2):
        found = bgr_from_message(msgs.image(0, pixels, encoding, padding), 'bag')
        wanted = pixels if code is None else cv2.cvtColor(pixels, getattr(cv2, 'COLOR_' + code))
        assert found.dtype == np.uint8 and found.flags.c_contiguous and found.flags.writeable
        np.testing.assert_array_equal(found, wanted)


def test_channels_by_hand(bags):
    red = np.zeros((2, 2, 3), np.uint8)
    red[..., 0] = 250
    np.testing.assert_array_equal(
        bgr_from_message(bags.ros2.image(0, red, 'rgb8'), 'bag'), red[..., ::-1])


@pytest.mark.parametrize('encoding', ['bayer_rggb8', 'bayer_bggr8', 'bayer_gbrg8',
                                      'bayer_grbg8'])
@pytest.mark.parametrize('padding', [0, 3])
def test_uniform_bayer_image_has_its_colour(bags, encoding, padding):
    """A flat scene: the mosaic is built by its ROS name, and demosaicing gives the colour."""
    cells = encoding[6:10]
    for rgb in ((200, 0, 0), (0, 200, 0), (0, 0, 200), (30, 90, 180)):
        value = dict(zip('rgb', rgb))
        cell = np.array([[value[cells[0]], value[cells[1]]],
                         [value[cells[2]], value[cells[3]]]], np.uint8)
        mosaic = np.tile(cell, (6, 8))
        raw = bgr_from_message(bags.ros2.image(0, mosaic, encoding, padding), 'bag')
        packed = bgr_from_message(bags.ros2.compressed(
            0, mosaic, 'png', f'{encoding}; png compressed {encoding}'), 'bag')
        for found in (raw, packed):
            assert found.shape == (12, 16, 3)
            np.testing.assert_array_equal(
                found[2:-2, 2:-2], np.broadcast_to(np.uint8(rgb[::-1]), (8, 12, 3)))


def test_grey_has_three_equal_channels(bags):
    pixels = bags.picture(2)
    found = bgr_from_message(bags.ros2.image(0, pixels, 'mono8', 3), 'bag')
    np.testing.assert_array_equal(found, np.repeat(pixels[..., None], 3, axis=-1))


@pytest.mark.parametrize('big', [False, True])
def test_sixteen_bits_keep_the_upper_eight(bags, big):
    pixels = np.array([[0, 255, 256], [0x1234, 0xff00, 0xffff]], np.uint16)
    found = bgr_from_message(bags.ros2.image(0, pixels, 'mono16', 0, big), 'bag')
    np.testing.assert_array_equal(found[..., 1], [[0, 0, 1], [0x12, 255, 255]])
    np.testing.assert_array_equal(bgr_of_grey(pixels), found)


@pytest.mark.parametrize('kind', ['png', 'jpg'])
def test_compressed_equals_imdecode(bags, kind):
    pixels = cv2.GaussianBlur(bags.picture(3, (24, 32, 3)), (0, 0), 3)
    msg = bags.ros2.compressed(0, pixels, kind, f'bgr8; {kind} compressed bgr8')
    found = bgr_from_message(msg, 'bag')
    np.testing.assert_array_equal(found, cv2.imdecode(msg.data, cv2.IMREAD_COLOR))
    if kind == 'png':
        np.testing.assert_array_equal(found, pixels)


def test_compressed_grey_has_three_equal_channels(bags):
    pixels = bags.picture(4)
    found = bgr_from_message(bags.ros2.compressed(0, pixels, 'png', 'mono8; png'), 'bag')
    np.testing.assert_array_equal(found, np.repeat(pixels[..., None], 3, axis=-1))


def test_unusable_image_is_named(bags):
    with pytest.raises(BagError, match=r"a\.mcap: encoding: found '32FC1', wanted one of mono8"):
        bgr_from_message(bags.ros2.image(0, bags.picture(1), '32FC1'), 'a.mcap')
    with pytest.raises(BagError, match='image data: found 191 bytes'):
        whole = bags.ros2.image(0, bags.picture(1))
        fields = {n: getattr(whole, n) for n in ('height', 'width', 'encoding', 'is_bigendian',
                                                 'step')}
        bgr_from_message(SimpleNamespace(**fields, data=whole.data[:-1]), 'a.mcap')
    for share in (0.0, 0.5):
        whole = bags.ros2.compressed(0, bags.picture(5, (40, 40, 3)))
        cut = SimpleNamespace(format='jpeg', data=whole.data[:int(share * len(whole.data))])
        with pytest.raises(BagError, match='compressed image'):
            bgr_from_message(cut, 'a.mcap')
