# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged messages: what is false in them, and what is not."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.io.decoding import stated_size
from stereo_speed.lab.cli.fuzz_messages import with_jpeg_sizes, with_png_sizes


@pytest.mark.parametrize('make', [with_png_sizes, with_jpeg_sizes])
def test_files_with_false_sizes_are_otherwise_whole(make):
    kind = '.png' if 'png' in make.__name__ else '.jpg'
    data = cv2.imencode(kind, np.full((8, 12), 99, np.uint8))[1].tobytes()
    width, height = cv2.imdecode(np.frombuffer(data, np.uint8), 0).shape[::-1]
    same = make(data, (width, height) if kind == '.png' else (height, width))
    assert same == data
    assert stated_size(make(data, (700, 500)))[:2] in ((700, 500), (500, 700))
