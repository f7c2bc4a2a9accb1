# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The focus of the cameras of a stream."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.core.records import StereoPair
from stereo_speed.steadying.view_focus import Focus, ViewFocus

S_NS = 1_000_000_000
DETAILS = cv2.GaussianBlur(
    np.random.default_rng(1).normal(128, 200, (256, 384)), (0, 0), 1.0).clip(0, 255)


def pair(at_s, right_blur_px=0.0, image=DETAILS):
    """Return a pair of one image, whose right view is out of focus."""
    right = cv2.GaussianBlur(image, (0, 0), right_blur_px) if right_blur_px else image
    return StereoPair(0, round(at_s * S_NS), round(at_s * S_NS), image.astype(np.uint8),
                      right.astype(np.uint8))


def test_first_pair_tells_and_later_ones_have_it():
    focus = ViewFocus()
    for at_s in (0.0, 0.1, 0.2):
        assert focus.seen(pair(at_s, 1.5)).blur_px2 == pytest.approx(2.25, abs=0.3)
    assert focus.state.looks == 1  # focus does not change that fast


def test_focus_that_changes_is_followed():
    focus = ViewFocus()
    for at_s in range(0, 20, 2):
        focus.seen(pair(at_s))
    assert abs(focus.state.blur_px) < 0.3 and not focus.state.warning()
    for at_s in range(20, 120, 2):
        focus.seen(pair(at_s, 2.0))
    assert focus.state.blur_px == pytest.approx(2.0, abs=0.2)
    assert 'right camera is out of focus' in focus.state.warning()


def test_warning_names_the_camera():
    assert Focus(blur_px2=-4.0).warning().startswith('the left camera is out of focus')
    assert '2.0 px' in Focus(blur_px2=-4.0).warning()
    assert Focus(blur_px2=-4.0).summary()['right_blur_px'] == -2.0


def test_blank_pair_keeps_what_is_known():
    focus = ViewFocus()
    focus.seen(pair(0.0, 1.5))
    known = focus.state.blur_px2
    assert focus.seen(pair(2.0, image=np.full((256, 384), 80.0))).blur_px2 == known
    assert (focus.state.looks, focus.state.unknown) == (1, 1)


def test_jump_back_in_time_is_no_end_of_looking():
    focus = ViewFocus()
    focus.seen(pair(100.0))
    focus.restart()
    focus.seen(pair(1.0))
    assert focus.state.looks == 2
