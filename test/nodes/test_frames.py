# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Static frames by hand, and messages with unknown values."""
from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.clock import Clock  # noqa: E402
from rclpy.qos import DurabilityPolicy  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402
from stereo_speed.core.records import TrackState, TrackUpdate  # noqa: E402
from stereo_speed.io.bags import StereoBag  # noqa: E402
from stereo_speed.nodes import frames  # noqa: E402
from stereo_speed.nodes.frames import static_transforms  # noqa: E402
from stereo_speed.nodes.messages import markers, odometry, path_markers  # noqa: E402
from stereo_speed.nodes.speeds import speed_of  # noqa: E402
from stereo_speed.pipeline.assembly import MeasuringSite  # noqa: E402
from stereo_speed.site.file import load_site  # noqa: E402
from visualization_msgs.msg import Marker  # noqa: E402

UPDATE = TrackUpdate(1_500_000_000, 3, 'near', TrackState.CONFIRMED, 24.5, 0.1, 12.0, 0.0,
                     np.array([1.0, 2.0, 30.0]), np.eye(3), np.eye(3), np.zeros((4, 2)),
                     np.zeros((4, 2)))


@pytest.fixture(scope='module')
def place(sample):
    with StereoBag(sample / 'bag') as bag:
        return MeasuringSite.of(load_site(sample / 'site.yaml'), bag.rig)


def moved(transform, point):
    """Return a point of the child frame in the parent frame."""
    t, q = transform.transform.translation, transform.transform.rotation
    return Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(point) + [t.x, t.y, t.z]


def test_road_frame_has_z_up_and_x_along_travel(place):
    lane = next(iter(place.lanes.values()))
    road, _ = static_transforms(place.rig, lane, road='road', right='right')
    assert (road.header.frame_id, road.child_frame_id) == ('road', place.rig.frame_id)
    points = lane.path.position(np.array([0.0, 10.0]))
    np.testing.assert_allclose(moved(road, points[0]), 0.0, atol=1e-9)
    np.testing.assert_allclose(moved(road, points[1]), [10.0, 0.0, 0.0], atol=0.2)
    assert moved(road, np.zeros(3))[2] > 2.0  # the camera is above the road


def test_right_camera_is_to_the_right_of_the_left_one(place):
    _, right = static_transforms(place.rig, next(iter(place.lanes.values())), road='road',
                                 right='right')
    assert (right.header.frame_id, right.child_frame_id) == (place.rig.frame_id, 'right')
    at = moved(right, np.zeros(3))
    assert np.linalg.norm(at) == pytest.approx(place.rig.baseline_m) and at[0] > 0.4
    point = np.array([1.0, 0.5, 20.0])
    np.testing.assert_allclose(moved(right, place.rig.to_right(point)), point, atol=1e-9)


@pytest.mark.parametrize('installed', [True, False])
def test_frames_are_published_once_where_their_message_is_installed(place, installed, monkeypatch):
    """Part of ROS, but not on PyPI; without it only a log line is written."""
    told, made, logged = [], [], []

    def create_publisher(kind, topic, qos):
        made.append((topic, qos.durability))
        return SimpleNamespace(publish=told.append)
    monkeypatch.setattr(frames, 'TFMessage', SimpleNamespace if installed else None)
    node = SimpleNamespace(create_publisher=create_publisher, get_clock=Clock,
                           get_logger=lambda: SimpleNamespace(info=logged.append))
    given = {'road_frame': 'road_b'}
    static = frames.StaticFrames(node, SimpleNamespace(
        get=lambda name, default, *_: given.get(name, default)))
    static.publish(place.rig, place.lanes)
    if not installed:
        assert (made, told) == ([], []) and 'tf2_msgs is not installed' in logged[0]
        return
    assert made == [('/tf_static', DurabilityPolicy.TRANSIENT_LOCAL)] and not logged
    assert [(t.header.frame_id, t.child_frame_id) for t in told[0].transforms] == [
        ('road_b', place.rig.frame_id), (place.rig.frame_id, 'stereo_right_optical_frame')]


def test_unmeasured_values_are_marked_unknown():
    track = odometry(UPDATE, 'left')
    assert track.twist.covariance[0] == pytest.approx(0.01)
    for k in range(1, 6):
        assert track.twist.covariance[7 * k] == 1e6
    assert [track.pose.covariance[7 * k] for k in range(6)] == [1.0] * 3 + [1e6] * 3
    speed = speed_of(track)
    assert (speed.header.frame_id, speed.twist.twist.linear.x) == ('vehicle_3', 24.5)
    assert speed.twist.covariance[0] == pytest.approx(0.01)
    for state in (TrackState.TENTATIVE, TrackState.COASTING):
        assert speed_of(odometry(replace(UPDATE, state=state), 'left')) is None


def test_lanes_replace_all_earlier_markers_and_lifetimes_are_as_set(place):
    drawn = path_markers(place.lanes, 'left')
    assert drawn[0].action == Marker.DELETEALL
    assert [m.action for m in drawn[1:]] == [Marker.ADD] * len(place.lanes)
    assert all(m.lifetime.sec == 2 and m.lifetime.nanosec == 500_000_000
               for m in markers(UPDATE, 'left', 2.5))
