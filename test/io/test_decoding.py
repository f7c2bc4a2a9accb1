# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged images are detected, false sizes refused, and decoder output sorted from other lines."""
from __future__ import annotations

import os
import struct
import zlib

import cv2
import numpy as np
import pytest
from stereo_speed.io.decoding import caught_chatter, decode_image, MOST_BYTES, stated_size


def encoded(kind, shape=(48, 64), **options):
    """Return the bytes of a random image."""
    pixels = np.random.default_rng(1).integers(0, 256, shape, np.uint8)
    return cv2.imencode(kind, pixels, [v for o in options.items() for v in (
        getattr(cv2, o[0]), o[1])])[1].tobytes()


def decoded(data):
    return decode_image(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)


def png_of(width, height):
    """Make a PNG that states a size without having the pixels."""
    def chunk(kind, body):
        return struct.pack('>I', len(body)) + kind + body + struct.pack(
            '>I', zlib.crc32(kind + body))
    return b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack('>IIBBBBB', width, height, 8, 0, 0,
                                                             0, 0)) + chunk(
        b'IDAT', zlib.compress(bytes(100))) + chunk(b'IEND', b'')


@pytest.mark.parametrize('data', [
    encoded('.jpg'), encoded('.png'), encoded('.jpg', (48, 64, 3)),
    encoded('.jpg', IMWRITE_JPEG_PROGRESSIVE=1), encoded('.jpg', IMWRITE_JPEG_RST_INTERVAL=2)],
    ids=['jpeg', 'png', 'colour', 'progressive', 'restarts'])
def test_whole_images_are_decoded_and_state_their_size(data, capfd):
    image, why = decoded(data)
    assert image.shape == (48, 64) and why == ''
    assert stated_size(data)[:2] == (64, 48)
    assert capfd.readouterr().err == ''


def test_jpeg_that_opencv_would_fill_with_grey_is_refused(capfd):
    data = encoded('.jpg')
    cut = data[:len(data) // 2] + b'\xff\xd9'
    assert cv2.imdecode(np.frombuffer(cut, np.uint8), cv2.IMREAD_GRAYSCALE) is not None
    assert 'Corrupt JPEG' in capfd.readouterr().err  # libjpeg's line, outside of the catch
    image, why = decoded(cut)
    assert image is None
    assert 'Corrupt JPEG data' in why
    assert capfd.readouterr().err == ''


@pytest.mark.parametrize('size', [(60000, 60000), (2 ** 31 - 1, 2 ** 31 - 1), (0, 5),
                                  (MOST_BYTES + 1, 1)])
def test_unrealistic_sizes_are_refused_before_decoding(size, capfd):
    image, why = decoded(png_of(*size))
    assert image is None
    assert why == f'{size[0]}x{size[1]} px in {len(png_of(*size))} bytes'
    assert capfd.readouterr().err == ''


def test_bytes_per_pixel_count_too():
    """5000x5000 px fit as 8-bit grey, but not as 16-bit colour with transparency."""
    small, large = (stated_size(b'\x89PNG\r\n\x1a\n' + bytes(8) + struct.pack(
        '>IIBB', 5000, 5000, depth, kind)) for depth, kind in ((8, 0), (16, 6)))
    assert (small, large) == ((5000, 5000, 1), (5000, 5000, 8))
    assert np.prod(small) <= MOST_BYTES < np.prod(large)


def test_chunk_longer_than_the_file_is_refused():
    data = bytearray(encoded('.png'))
    at = data.index(b'IDAT') - 4
    data[at:at + 4] = b'\xf0\x00\x00\x00'  # four gigabytes, which a decoder would allocate
    assert 'beyond the end' in decoded(bytes(data))[1]


def test_jpeg_of_a_false_size_is_refused():
    data = bytearray(encoded('.jpg'))
    at = data.index(b'\xff\xc0')
    data[at + 5:at + 9] = struct.pack('>HH', 65000, 65000)
    assert decoded(bytes(data))[1].startswith('65000x65000 px')


@pytest.mark.parametrize(
    'data', [b'', b'\xff\xd8\xff', b'\x89PNG\r\n\x1a\n', b'GIF89a', bytes(40)])
def test_invalid_image_is_refused(data):
    image, why = decoded(data)  # libpng of some OpenCV versions adds details
    assert image is None and why.startswith(f'{len(data)} bytes that cannot be decoded')
    assert '\n' not in why
    assert stated_size(data) is None


def test_messages_of_other_code_are_passed_on(capfd):
    with caught_chatter() as lines:
        os.write(2, b'[ERROR] [17.1] [tracker_node]: a log line of ROS\n'
                 b'Corrupt JPEG data: bad Huffman code\nanother\n')
        with caught_chatter() as inner:
            os.write(2, b'Premature end of JPEG file\n')
    assert (lines, inner) == (['Corrupt JPEG data: bad Huffman code'],
                              ['Premature end of JPEG file'])
    assert capfd.readouterr().err == '[ERROR] [17.1] [tracker_node]: a log line of ROS\nanother\n'
