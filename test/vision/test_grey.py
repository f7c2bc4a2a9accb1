# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Conversion of images of any depth to 8 bits."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.vision.grey import to_eight_bits, white_level


def test_eight_bit_images_are_unchanged():
    image = np.arange(12, dtype=np.uint8).reshape(3, 4)
    np.testing.assert_array_equal(to_eight_bits(image), image)
    assert to_eight_bits(image[:, ::2]).flags.c_contiguous


@pytest.mark.parametrize('bits', [8, 10, 12, 16])
def test_white_is_the_maximum_of_the_bit_depth(bits):
    white = 2 ** bits - 1
    image = np.array([[0, white // 2 + 1, white]], np.uint16)
    assert to_eight_bits(image).tolist() == [[0, 128, 255]]


def test_images_of_one_camera_scale_alike():
    first, second = (np.array([[800, brightest]], np.uint16) for brightest in (2100, 4000))
    assert to_eight_bits(first)[0, 0] == to_eight_bits(second)[0, 0] == round(800 * 255 / 4095)


def test_dark_images_are_not_brightened():
    assert to_eight_bits(np.array([[3, 7]], np.uint16)).tolist() == [[3, 7]]


@pytest.mark.parametrize('brightest, white', [
    (0, 255), (255, 255), (256, 1023), (1023, 1023), (1500, 4095), (4095, 4095), (9000, 16383),
    (40000, 65535), (65520, 65535)])  # the last one has 12 bits in the upper part of 16
def test_white_is_where_a_camera_of_its_bits_clips(brightest, white):
    dark, bright = np.zeros((2, 3), np.uint16), np.full((2, 3), 7, np.uint16)
    bright[1, 2] = brightest
    assert white_level([dark, bright]) == white
    assert white_level([dark.astype(np.uint8), bright.astype(np.uint8)]) == 255
