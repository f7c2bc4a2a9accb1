# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Images are counted once: as paired, refused or lost on the way."""
from __future__ import annotations

import pytest

pytest.importorskip('rclpy')

import numpy as np  # noqa: E402, I100
import rclpy  # noqa: E402
from stereo_speed.nodes.common import image_message, Parameters  # noqa: E402
from stereo_speed.nodes.health import OK, WARN  # noqa: E402
from stereo_speed.nodes.pairing import Pairing  # noqa: E402

PERIOD_NS = 50_000_000


@pytest.fixture()
def pairing(in_process):
    """Return a pairing that has received eight pairs, so that it knows the period."""
    with in_process(lambda: rclpy.create_node('rig')) as node:
        pairing = Pairing(node, Parameters(node), lambda pair: None)
        pairing.subscribe()
        for number in range(8):
            for side in ('left', 'right'):
                pairing.on_image(side, image(number))
        yield pairing
        pairing.close()


def image(number, *, short=False):
    """Return an image with the stamp of a period; a short one lacks bytes."""
    pixels = np.random.default_rng(number).integers(0, 255, (24, 32), np.uint8)
    msg = image_message(pixels, ns=number * PERIOD_NS, frame_id='left_optical')
    if short:
        msg.data = msg.data[:10]
    return msg


def found(pairing):
    """Return level and message of the left camera, and the images refused and lost."""
    state = pairing.tasks['left camera']()
    return (state.level, state.message, pairing.refusals.tally.total, state.values['lost'])


def test_refused_image_does_not_count_as_lost(pairing):
    for number in (8, 9):
        pairing.on_image('left', image(number, short=True))
    pairing.on_image('left', image(10))
    assert found(pairing) == (OK, 'receiving images', 2, 0)
    state = pairing.tasks['pairs']()
    assert state.level == WARN and '2 messages refused' in state.message


def test_images_lost_before_a_refused_one_count_as_lost(pairing):
    pairing.on_image('left', image(10, short=True))
    pairing.on_image('left', image(11))
    level, message, refused, lost = found(pairing)
    assert (level, refused, lost) == (WARN, 1, 2)
    assert message == '2 left images lost on the way: their stamps are missing'


def test_refused_image_with_an_old_stamp_changes_nothing(pairing):
    pairing.on_image('left', image(3, short=True))
    pairing.on_image('left', image(8))
    assert found(pairing) == (OK, 'receiving images', 1, 0)


def test_image_that_is_sent_again_after_a_refused_one_is_paired(pairing):
    pairing.on_image('left', image(8, short=True))
    for side in ('left', 'right'):
        pairing.on_image(side, image(8))
    assert pairing.pairs.tally.total == 9
    assert found(pairing) == (OK, 'receiving images', 1, 0)
