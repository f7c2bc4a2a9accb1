# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``environment_node``: the images of one camera in, the marked targets out.

It runs the same tracker as ``track-environment``. Frames are numbered from 1 since the start or
the last jump of time, as is ``frame`` of the targets file; their stamps show how many were lost.
Targets may also be marked while the node runs, by the stamp of a frame: see ``marks``.
"""
from __future__ import annotations

from collections import deque, OrderedDict
from functools import partial
from typing import Any, Sequence

from geometry_msgs.msg import PolygonStamped
import numpy as np
from numpy.typing import NDArray
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Image, PointCloud2
from visualization_msgs.msg import MarkerArray

from .common import (
    image_message, JUMP_NS, Parameters, qos_options, RELIABLE, run, stamp_ns)
from .diagnostics import Diagnostics
from .environment_messages import target_deletions, target_markers, tracks_message
from .health import Arrivals, Refusals, State, Tally, WARN
from .marks import MARK_TOPIC, target_from_message
from .subscriptions import image_kind, OfferedSubscription
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
_WAITING_FRAMES = 10  # a tracker that does not keep up loses frames rather than lag behind
_MOST_MARKS = 50  # greatest number of marks that wait for their frames


class EnvironmentNode(Node):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__('environment_node')
        p = Parameters(self)
        where = f'{self.get_name()}: parameter'
        self.map_path = p.get('map', '', 'path of the map')
        targets = p.get('targets', '', 'path of the targets file; empty if all targets are '
                        'marked on the topic mark')
        kept = p.get('mark_frames', 50, 'number of recent frames that are kept, in which a target '
                     'can still be marked', 1, 1000)
        self.seed = p.get('seed', 0, 'seed of all randomness', 0, 2 ** 31 - 1)
        self.tracker_name = p.get('tracker', 'environment', 'tracker: ' + ', '.join(TRACKERS))
        self.stride = p.get('stride', 1, 'use every stride-th frame, counted from the frame of '
                            'each mark', 1, 1_000_000)
        kind, suffix = image_kind(p)
        self.metres_per_px = p.get('marker_metres_per_px', 0.01, 'size of a pixel in the markers '
                                   '[m]', 1e-6, 1e3)
        self.config = p.config(MonocularConfig)
        if not self.map_path:
            raise InputError(where, 'map', 'nothing', 'the path of the map')
        if self.tracker_name not in TRACKERS:
            raise InputError(where, 'tracker', self.tracker_name, ', '.join(TRACKERS))
        self.labels = load_map(self.map_path)
        self.targets = load_targets(targets) if targets else []
        check_targets(self.targets, self.labels.shape[1], self.labels.shape[0], targets)
        self.frames: deque[tuple[int, int, NDArray[np.uint8]]] = deque(maxlen=kept)
        self.marks: OrderedDict[int, PolygonStamped] = OrderedDict()  # by stamps of coming frames
        self._next_id, self.marked = max((t.id for t in self.targets), default=0) + 1, 0
        self.field = DistanceField(self.labels)
        self.counter, self.resets, self.marks_missed = FrameCounter(JUMP_NS), 0, Tally()
        self.ends = dict.fromkeys(TargetState, 0)
        self.tracker = self._new_tracker()
        self._publish_and_subscribe(kind, suffix)
        self.arrivals, self.refusals = Arrivals(), Refusals(self.get_logger().warning)
        self.diagnostics = Diagnostics(self, {'pipeline': self.state})

    def _new_tracker(self) -> MonocularTracker:
        return MonocularTracker(self.field, self.targets, self.config, tracker=self.tracker_name,
                                seed=self.seed, stride=self.stride, more_later=True)

    def _publish_and_subscribe(self, kind: type, suffix: str) -> None:
        options = {'qos_overriding_options': qos_options()}
        self.tracks = self.create_publisher(PointCloud2, 'tracks', RELIABLE, **options)
        self.markers = self.create_publisher(MarkerArray, 'markers', RELIABLE, **options)
        self.overlay = self.create_publisher(Image, 'overlay/image_raw', RELIABLE, **options)
        self.subscription = OfferedSubscription(
            self, kind, _TOPIC + suffix, self.on_image, depth=_WAITING_FRAMES)
        self.create_subscription(PolygonStamped, MARK_TOPIC, self.on_mark, RELIABLE, **options)

    def on_image(self, msg: Any) -> None:
        """Run the tracker on a frame and publish its estimates."""
        ns = stamp_ns(msg.header.stamp)
        try:
            image = bgr_from_message(msg, _TOPIC)
            check_map_size(self.labels, image, self.map_path)
        except InputError as error:
            self.refusals.add(_TOPIC, error)
            return
        self.arrivals.add()
        if self.counter.jumps_back(ns):
            self.restart(ns)
        frames = self.counter.step(ns)
        if frames == 0:
            return
        if frames > 1:
            self.on_gap(frames - 1)
        while self.marks and next(iter(self.marks)) <= ns:
            due_ns, mark = self.marks.popitem(last=False)
            if due_ns == ns:
                self.follow(mark, self.counter.number, ())
            else:
                self.miss(due_ns)
        self.frames.append((ns, self.counter.number, image))
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

    def on_mark(self, msg: PolygonStamped) -> None:
        """Follow a target that is marked in a kept frame or in one still to come."""
        ns = stamp_ns(msg.header.stamp)
        if ns > self.counter.last_ns:
            self.marks[ns] = msg
            self.marks = OrderedDict(sorted(self.marks.items()))
            if len(self.marks) > _MOST_MARKS:
                self.miss(self.marks.popitem()[0])
            return
        since = [(number, image) for kept_ns, number, image in self.frames if kept_ns >= ns]
        if ns in (kept_ns for kept_ns, _, _ in self.frames):
            self.follow(msg, since[0][0], since)
        else:
            self.miss(ns)

    def follow(self, msg: PolygonStamped, number: int,
               since: Sequence[tuple[int, NDArray[np.uint8]]]) -> None:
        """
        Follow a target from the frame in which it is marked.

        :param msg: the mark.
        :param number: number of that frame.
        :param since: number and image of that frame and all later ones, as far as processed.
        """
        try:
            target = target_from_message(msg, self._next_id, number)
            check_targets([target], self.labels.shape[1], self.labels.shape[0], MARK_TOPIC)
        except InputError as error:
            self.refusals.add(MARK_TOPIC, error)
            return
        self._next_id, self.marked = self._next_id + 1, self.marked + 1
        self.get_logger().info(f'target {target.id}: marked in frame {target.frame}')
        self.tracker.mark(target, since)

    def miss(self, ns: int) -> None:
        """Refuse a mark whose frame is not available."""
        self.marks_missed.add()
        kept = 'none yet' if not self.frames else (
            f'{len(self.frames)}, from {self.frames[0][0]} to {self.frames[-1][0]} ns')
        self.refusals.add(MARK_TOPIC, InputError(
            MARK_TOPIC, 'stamp', ns,
            f'the stamp of a frame that is kept ({kept}) or arrives soon'))

    def on_gap(self, dropped: int) -> None:
        """
        Account for the frames missing before the present one.

        A target marked in one of them is never followed. No target is followed over a gap that
        is longer than a target may be occluded.
        """
        last = self.counter.number - 1
        for target in self.targets:
            if last - dropped < target.frame <= last:
                self.marks_missed.add()
                self.get_logger().warning(f'target {target.id}: not followed, because its '
                                          f'frame {target.frame} never arrived')
        if dropped >= self.config.hidden_frames:
            for number in list(self.tracker.filters):
                self.tracker.stop(number)

    def restart(self, ns: int) -> None:
        """End all targets and count frames from 1, because time has jumped back."""
        self.get_logger().warning(
            f'stamps jumped back from {self.counter.last_ns} to {ns} ns: starting again')
        self.close()
        self.counter.restart()
        self.frames.clear()
        self.marks.clear()
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

    def state(self) -> State:
        """Return the state for ``/diagnostics``."""
        c, ends, state = self.counter, self.ends, State('tracking')
        self.arrivals.tell(state, 'image', 'image')
        if self.marks_missed.recent:
            state.find(WARN, f'{self.marks_missed.recent} marks whose frames never arrived')
        state.values.update({
            'frames': c.number, 'followed': len(self.tracker.filters),
            'ended': sum(ends.values()), 'lost': ends[TargetState.LOST],
            'left_view': ends[TargetState.LEFT_VIEW], 'resets': self.resets, 'gaps': c.gaps,
            'dropped': c.dropped, 'marked': self.marked,
            'marks_missed': self.marks_missed.total, 'repeated': c.repeated, 'late': c.late})
        self.refusals.tell(state)
        return state


main = partial(run, EnvironmentNode)

if __name__ == '__main__':
    raise SystemExit(main())
