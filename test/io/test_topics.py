# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Topics found by type and name."""
import pytest

from stereo_speed.core.errors import BagError
from stereo_speed.io.topics import choose_topics, side_of

I, C, INFO = (f'sensor_msgs/msg/{n}' for n in ('Image', 'CompressedImage', 'CameraInfo'))
INFOS = {'/s/left/camera_info': INFO, '/s/right/camera_info': INFO}
RAW = {'/s/left/image_raw': I, '/s/right/image_raw': I}


@pytest.mark.parametrize(('topic', 'side'), [
    ('/stereo/left/image_raw', 'left'), ('/cam_Right/image', 'right'),
    ('/left_right/left/image', 'left'), ('/left/rig/right', 'right'), ('/left_right/a', None),
    ('/camera/image', None)])
def test_side_of(topic, side):
    assert side_of(topic) == side


def test_plain_pair():
    topics = choose_topics({**RAW, **INFOS, '/tf': 'tf2_msgs/msg/TFMessage'}, (None, None), 'b')
    assert topics.images == ('/s/left/image_raw', '/s/right/image_raw')
    assert topics.infos == ('/s/left/camera_info', '/s/right/camera_info')


def test_raw_images_are_preferred_to_their_compressed_form():
    both = {t + '/compressed': C for t in RAW} | {t + '/compressedDepth': C for t in RAW}
    assert choose_topics({**RAW, **both, **INFOS}, (None, None), 'b').images == tuple(RAW)
    topics = choose_topics({**both, **INFOS}, (None, None), 'b')
    assert topics.images == tuple(t + '/compressed' for t in RAW)
    assert topics.infos == tuple(INFOS)


def test_given_topics_need_no_side_in_their_names():
    types = {'/cam0/image_raw': I, '/cam1/image_raw': I, '/cam0/camera_info': INFO,
             '/cam1/camera_info': INFO}
    topics = choose_topics(types, ('/cam0/image_raw', 'cam1/image_raw'), 'b')
    assert topics.infos == ('/cam0/camera_info', '/cam1/camera_info')


def test_calibration_of_another_namespace_is_found_by_its_side():
    types = {**RAW, '/calib/left_info': INFO, '/calib/right_info': INFO}
    assert choose_topics(types, (None, None), 'b').infos == ('/calib/left_info',
                                                             '/calib/right_info')


@pytest.mark.parametrize(('types', 'given', 'told'), [
    ({}, (None, None), 'b: left image topic: found no messages at all, wanted one Image or'),
    (INFOS, (None, None), r'left image topic: found /s/left/camera_info \(CameraInfo\), /s/r'),
    ({'/s/left/image_raw': I, **INFOS}, (None, None), 'right image topic: found .*--right TOPIC'),
    ({**RAW, '/t/left/image_raw': I, **INFOS}, (None, None),
     'left image topic: found /s/left/image_raw and /t/left/image_raw, wanted one only; choose '
     'with --left TOPIC'),
    (RAW, (None, None), r'left camera_info: found .*wanted /s/left/camera_info \(CameraInfo\)'),
    ({**RAW, '/s/left/camera_info': INFO}, (None, None), 'right camera_info: found'),
    ({**RAW, **INFOS}, ('/nope', None), '--left /nope: found .*wanted a topic of images'),
    ({**RAW, **INFOS}, ('/s/left/camera_info', None), '--left /s/left/camera_info: found'),
    ({**RAW, **INFOS}, ('/s/left/image_raw', '/s/left/image_raw'), 'for both sides'),
], ids=['empty', 'no images', 'one side', 'two candidates', 'no info', 'one info', 'not there',
        'wrong type', 'same twice'])
def test_refusals(types, given, told):
    with pytest.raises(BagError, match=told):
        choose_topics(types, given, 'b')
