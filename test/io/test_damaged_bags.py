# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Bags, calibrations and videos from fuzzing: each gives one line."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.core.errors import BagError, CalibrationError, InputError
from stereo_speed.io.bags import StereoBag
from stereo_speed.io.camera_info import rig_from_info
from stereo_speed.io.truth import read_truth
from stereo_speed.io.video import read_frames
import yaml


@pytest.mark.parametrize('change', [
    {'topic_metadata': {'name': {}}}, {'topic_metadata': {'type': []}}, {'message_count': 'x'}],
    ids=['name', 'type', 'count'])
def test_metadata_with_unnamed_topics(bags, tmp_path, change):
    bag = bags.write(tmp_path / 'bag', bags.recording(bags.ros2), bags.ros2)
    path = bag / 'metadata.yaml'
    data = yaml.safe_load(path.read_text())
    topic = data['rosbag2_bagfile_information']['topics_with_message_count'][0]
    for key, value in change.items():
        topic[key] = {**topic[key], **value} if isinstance(value, dict) else value
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(BagError, match='metadata|wanted a whole, readable bag'):
        with StereoBag(bag) as opened:
            list(opened.pairs())


def test_metadata_that_refer_to_files_elsewhere_are_not_followed(bags, tmp_path):
    bag = bags.write(tmp_path / 'bag', bags.recording(bags.ros2), bags.ros2)
    file, = (p for p in bag.iterdir() if p.suffix != '.yaml')
    elsewhere = tmp_path / file.name
    file.rename(elsewhere)
    path = bag / 'metadata.yaml'
    text = path.read_text()
    for name in (f'../{file.name}', str(elsewhere)):
        path.write_text(text.replace(file.name, name))
        assert name in path.read_text()
        with pytest.raises(BagError, match='missing'):
            StereoBag(bag).__enter__()


@pytest.mark.parametrize(('field', 'at', 'value'), [
    ('k', 0, 1e300), ('k', 0, 1e-300), ('k', 2, 1e7), ('d', 0, 1e200), ('r', 0, 1e200),
    ('p', 3, -1e300)])
def test_calibrations_without_a_camera(bags, field, at, value):
    infos = [bags.ros2.info(0, side) for side in ('left', 'right')]
    getattr(infos[1], field)[at] = value
    with np.errstate(all='raise'), pytest.raises(CalibrationError, match=field.upper()):
        rig_from_info(*infos, 'bag')


def test_video_with_a_lost_index_is_read_without_library_messages(tmp_path, capfd):
    path = tmp_path / 'video.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), 10.0, (32, 24))
    for level in range(0, 200, 40):
        writer.write(np.full((24, 32, 3), level, np.uint8))
    writer.release()
    data = path.read_bytes()
    path.write_bytes(data[:data.rindex(b'idx1')])
    capfd.readouterr()
    frames = list(read_frames(path))
    assert len(frames) <= 5
    assert capfd.readouterr().err == ''


def test_metadata_with_a_string_for_its_files(bags, tmp_path):
    bag = bags.write(tmp_path / 'bag', bags.recording(bags.ros2), bags.ros2)
    path = bag / 'metadata.yaml'
    data = yaml.safe_load(path.read_text())
    data['rosbag2_bagfile_information']['relative_file_paths'] = ''
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(BagError):
        with StereoBag(bag) as opened:
            list(opened.pairs())


def test_truth_with_invalid_stamps(tmp_path):
    path = tmp_path / 'truth.csv'
    path.write_text('stamp,speed\n1e200,20\n')
    with pytest.raises(InputError, match='line 2, stamp'):
        read_truth(path)
