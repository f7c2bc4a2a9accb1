# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Every encoding against OpenCV, with messages of both ROS versions."""
from array import array
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from stereo_speed.core.errors import BagError
from stereo_speed.io.images import grey_from_message

COLOUR = {'bgr8': (3, 'BGR'), 'rgb8': (3, 'RGB'), 'bgra8': (4, 'BGRA'), 'rgba8': (4, 'RGBA')}


@pytest.mark.parametrize('padding', [0, 5])
@pytest.mark.parametrize('encoding', COLOUR)
def test_colour_equals_cvtcolor(bags, encoding, padding):
    channels, name = COLOUR[encoding]
    pixels = bags.picture(1, (12, 17, channels))
    grey = grey_from_message(bags.ros2.image(0, pixels, encoding, padding), 'bag')
    wanted = cv2.cvtColor(pixels, getattr(cv2, f'COLOR_{name}2GRAY'))
    np.testing.assert_array_equal(grey, wanted)


@pytest.mark.parametrize('padding', [0, 3])
def test_mono8_is_the_pixels(bags, padding):
    pixels = bags.picture(2)
    grey = grey_from_message(bags.ros2.image(0, pixels, 'mono8', padding), 'bag')
    np.testing.assert_array_equal(grey, pixels)
    assert grey.flags.c_contiguous and grey.flags.writeable


@pytest.mark.parametrize('big', [False, True])
@pytest.mark.parametrize('padding', [0, 6])
def test_mono16_in_both_byte_orders(bags, big, padding):
    pixels = bags.picture(3, dtype=np.uint16)
    grey = grey_from_message(bags.ros2.image(0, pixels, 'mono16', padding, big), 'bag')
    assert grey.dtype == np.uint16 and grey.dtype.isnative
    np.testing.assert_array_equal(grey, pixels)


@pytest.mark.parametrize('encoding', ['bayer_rggb8', 'bayer_bggr8', 'bayer_gbrg8',
                                      'bayer_grbg8'])
def test_uniform_bayer_image_has_the_grey_of_its_colour(bags, encoding):
    """A flat scene of pure red, green or blue: the mosaic is built by its ROS name."""
    colours = {'r': (200, 0, 0), 'g': (0, 200, 0), 'b': (0, 0, 200)}
    cells = encoding[6:10]
    for rgb in colours.values():
        value = dict(zip('rgb', rgb))
        cell = np.array([[value[cells[0]], value[cells[1]]],
                         [value[cells[2]], value[cells[3]]]], np.uint8)
        grey = grey_from_message(bags.ros2.image(0, np.tile(cell, (6, 8)), encoding), 'bag')
        wanted = cv2.cvtColor(np.uint8([[rgb]]), cv2.COLOR_RGB2GRAY)[0, 0]
        assert np.abs(grey[2:-2, 2:-2].astype(int) - int(wanted)).max() <= 1


@pytest.mark.parametrize('wrap', [bytes, lambda d: array('B', d.tobytes()), np.asarray])
def test_data_of_rclpy_and_rosbags_is_decoded(bags, wrap):
    msg = bags.ros2.image(0, bags.picture(4))
    live = SimpleNamespace(**{n: getattr(msg, n) for n in (
        'height', 'width', 'encoding', 'is_bigendian', 'step')}, data=wrap(msg.data))
    np.testing.assert_array_equal(grey_from_message(live, 'topic'), bags.picture(4))


def test_png_keeps_its_bit_depth(bags):
    for dtype in (np.uint8, np.uint16):
        pixels = bags.picture(5, dtype=dtype)
        grey = grey_from_message(bags.ros2.compressed(0, pixels, 'png', 'anything'), 'bag')
        assert grey.dtype == dtype
        np.testing.assert_array_equal(grey, pixels)


def test_jpeg_equals_imdecode(bags):
    smooth = cv2.GaussianBlur(bags.picture(6, (48, 64, 3)), (0, 0), 5)
    msg = bags.ros2.compressed(0, smooth, 'jpg', 'bgr8; jpeg compressed bgr8')
    grey = grey_from_message(msg, 'bag')
    np.testing.assert_array_equal(grey, cv2.imdecode(msg.data, cv2.IMREAD_GRAYSCALE))
    assert np.abs(grey.astype(int) - cv2.cvtColor(smooth, cv2.COLOR_BGR2GRAY)).max() < 12


def test_colour_png_equals_cvtcolor_up_to_rounding(bags):
    pixels = bags.picture(7, (12, 16, 3))
    grey = grey_from_message(bags.ros2.compressed(0, pixels, 'png', 'bgr8; png'), 'bag')
    wanted = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
    assert np.abs(grey.astype(int) - wanted).max() <= 1


def test_compressed_mosaic_is_decoded(bags):
    pixels = bags.picture(8)
    msg = bags.ros2.compressed(0, pixels, 'png', 'bayer_rggb8; png compressed bayer_rggb8')
    raw = bags.ros2.image(0, pixels, 'bayer_rggb8')
    np.testing.assert_array_equal(grey_from_message(msg, 'bag'), grey_from_message(raw, 'bag'))


def test_unknown_encoding(bags):
    msg = bags.ros2.image(0, bags.picture(1), '32FC1')
    with pytest.raises(BagError, match=r"a\.mcap: encoding: found '32FC1', wanted one of mono8"):
        grey_from_message(msg, 'a.mcap')


@pytest.mark.parametrize(('change', 'told'), [
    ({'step': 15}, 'step: found 15, wanted at least 16 bytes'),
    ({'height': 13}, 'image data: found 192 bytes, wanted 208 bytes'),
    ({'width': 0}, 'image size: found 0x12 px'),
    ({'data': np.zeros(0, np.uint8)}, 'image data: found 0 bytes'),
], ids=['step', 'short', 'empty', 'nothing'])
def test_inconsistent_layout_is_refused(bags, change, told):
    msg = bags.ros2.image(0, bags.picture(1))
    fields = {n: getattr(msg, n) for n in ('height', 'width', 'encoding', 'is_bigendian',
                                           'step', 'data')}
    with pytest.raises(BagError, match=told):
        grey_from_message(SimpleNamespace(**{**fields, **change}), 'bag')


@pytest.mark.parametrize('kind', ['jpg', 'png'])
@pytest.mark.parametrize('share', [0.0, 0.02, 0.5, 0.98])
def test_truncated_image_is_refused(bags, kind, share):
    """Without the check OpenCV would fill the rest of a truncated JPEG with grey."""
    whole = bags.ros2.compressed(0, bags.picture(9, (64, 64)), kind)
    cut = SimpleNamespace(format=kind, data=whole.data[:int(share * len(whole.data))])
    with pytest.raises(BagError, match='compressed image: found .*wanted a whole JPEG or PNG'):
        grey_from_message(cut, 'bag')


def test_bytes_of_no_image_are_refused(bags):
    junk = SimpleNamespace(format='jpeg', data=b'\xff\xd8\xff' + bytes(50) + b'\xff\xd9')
    with pytest.raises(BagError, match='55 bytes that cannot be decoded'):
        grey_from_message(junk, 'bag')
