# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``environment_node``: the images of one camera in, the marked targets out.

It runs the same tracker as ``track-environment``. Frames are numbered from 1 since the start or
the last jump of time, as ``frame`` of the targets file means them; their stamps show how many
were dropped on the way.
"""
from __future__ import annotations

from typing import Any, Optional, Sequence

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage, Image, PointCloud2
from visualization_msgs.msg import MarkerArray

from .common import (
    Diagnostics, image_message, JUMP_NS, Parameters, qos_options, RELIABLE, run, stamp_ns)
from .environment_messages import target_deletions, target_markers, tracks_message
from ..core.errors import InputError
from ..core.frame_counter import FrameCounter
from ..io.colour import bgr_from_message
from ..io.scene_map import check_map_size, load_map
from ..io.targets_file import check_targets, load_targets
from ..monocular.boxes import TargetEnd, TargetState
from ..monocular.config import MonocularConfig
from ..monocular.distance import DistanceField
from ..monocular.tracker import MonocularTracker, TRACKERS
from ..report.targets import draw_targets

_TOPIC = 'image_raw'


class EnvironmentNode(Node):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__('environment_node')
        p = Parameters(self)
        where = f'{self.get_name()}: parameter'
        paths = {name: p.get(name, '', f'path of the {name} file') for name in ('map', 'targets')}
        self.seed = p.get('seed', 0, 'seed of all randomness', 0, 2 ** 31 - 1)
        self.tracker_name = p.get('tracker', 'environment', 'tracker: ' + ', '.join(TRACKERS))
        self.stride = p.get('stride', 1, 'use every stride-th frame, counted from that of each '
                            'mark', 1, 1_000_000)
        transport = p.get('image_transport', 'raw', "'raw' or 'compressed' images")
        self.metres_per_px = p.get('marker_metres_per_px', 0.01, 'size of a pixel in the markers '
                                   '[m]', 1e-6, 1e3)
        self.config = p.config(MonocularConfig)
        for name, value in paths.items():
            if not value:
                raise InputError(where, name, 'nothing', f'the path of the {name} file')
        if self.tracker_name not in TRACKERS:
            raise InputError(where, 'tracker', self.tracker_name, ', '.join(TRACKERS))
        if transport not in ('raw', 'compressed'):
            raise InputError(where, 'image_transport', transport, 'raw or compressed')
        self.labels, self.targets = load_map(paths['map']), load_targets(paths['targets'])
        check_targets(self.targets, self.labels.shape[1], self.labels.shape[0], paths['targets'])
        self.map_path = paths['map']
        self.field = DistanceField(self.labels)
        self.counter, self.resets, self.marks_missed = FrameCounter(JUMP_NS), 0, 0
        self.ends = dict.fromkeys(TargetState, 0)
        self.tracker = self._new_tracker()
        self._publish_and_subscribe(transport)
        self.diagnostics = Diagnostics(self, self.state)

    def _new_tracker(self) -> MonocularTracker:
        return MonocularTracker(self.field, self.targets, self.config, tracker=self.tracker_name,
                                seed=self.seed, stride=self.stride)

    def _publish_and_subscribe(self, transport: str) -> None:
        options = {'qos_overriding_options': qos_options()}
        self.tracks = self.create_publisher(PointCloud2, 'tracks', RELIABLE, **options)
        self.markers = self.create_publisher(MarkerArray, 'markers', RELIABLE, **options)
        self.overlay = self.create_publisher(Image, 'overlay/image_raw', RELIABLE, **options)
        kind, topic = (Image, _TOPIC) if transport == 'raw' \
            else (CompressedImage, f'{_TOPIC}/compressed')
        self.create_subscription(kind, topic, self.on_image, qos_profile_sensor_data, **options)

    def on_image(self, msg: Any) -> None:
        """Run the tracker on a frame and publish its estimates."""
        ns = stamp_ns(msg.header.stamp)
        if self.counter.jumps_back(ns):
            self.restart(ns)
        image = bgr_from_message(msg, _TOPIC)
        check_map_size(self.labels, image, self.map_path)
        frames = self.counter.step(ns)
        if frames == 0:
            return
        if frames > 1:
            self.on_gap(frames - 1)
        estimates = self.tracker.process(self.counter.number, image)
        self.tracks.publish(tracks_message(estimates, msg.header))
        drawn = [m for e in estimates for m in target_markers(e, msg.header, self.metres_per_px)]
        for end in self.tracker.ended():
            drawn += target_deletions(end.id, msg.header)
            self.report(end)
        self.markers.publish(MarkerArray(markers=drawn))
        if self.overlay.get_subscription_count():  # drawing costs more than tracking
            self.overlay.publish(image_message(draw_targets(image, estimates, self.labels), ns=ns,
                                               frame_id=msg.header.frame_id))

    def on_gap(self, dropped: int) -> None:
        """
        Account for the frames missing before the present one.

        A target marked in one of them is never followed. No target is followed over a gap that
        is longer than a target may be occluded.
        """
        last = self.counter.number - 1
        for target in self.targets:
            if last - dropped < target.frame <= last:
                self.marks_missed += 1
                self.get_logger().warning(f'target {target.id}: its frame {target.frame} never '
                                          'came; it is not followed')
        if dropped >= self.config.hidden_frames:
            for number in list(self.tracker.filters):
                self.tracker.stop(number)

    def restart(self, ns: int) -> None:
        """End all targets and count frames from 1: time has jumped back."""
        self.get_logger().warning(
            f'stamps jumped back from {self.counter.last_ns} to {ns} ns: starting again')
        self.close()
        self.counter.restart()
        self.tracker = self._new_tracker()
        self.resets += 1

    def report(self, end: TargetEnd) -> None:
        """Log how a target ended."""
        self.ends[end.state] += 1
        self.get_logger().info(f'target {end.id}: {end.state.value}, frames {end.first_frame} to '
                               f'{end.last_frame}')

    def close(self) -> None:
        """End the targets that are still followed."""
        if rclpy.ok():  # otherwise the log is closed already
            for end in self.tracker.finish():
                self.report(end)

    def state(self) -> tuple[bytes, str, dict[str, Any]]:
        """Return level, message and counts for ``/diagnostics``."""
        c, ends = self.counter, self.ends
        level, message = b'\x00', 'tracking'
        if c.number == 0:
            level, message = b'\x01', 'waiting for images'
        elif self.marks_missed:
            level, message = b'\x01', 'frames with a mark in them never came'
        return level, message, {
            'frames': c.number, 'followed': len(self.tracker.filters),
            'ended': sum(ends.values()), 'lost': ends[TargetState.LOST],
            'left_view': ends[TargetState.LEFT_VIEW], 'resets': self.resets, 'gaps': c.gaps,
            'dropped': c.dropped, 'marks_missed': self.marks_missed, 'repeated': c.repeated,
            'late': c.late}


def main(args: Optional[Sequence[str]] = None) -> int:
    """Run the node."""
    return run(EnvironmentNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
