# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``tracker_node``: synchronized pairs in, tracks, markers and an overlay out.

It runs the same pipeline as ``replay``; pairs are counted from 0 since the start or the last jump
of time, as ``frame`` of the init file means them.  A jump shows in the stamps of the pairs and in
nothing else: ``/clock`` runs ahead of pairs that are still queued, and would cut their pass short.
"""
from __future__ import annotations

from collections import deque
from typing import Any, Optional, Sequence

from nav_msgs.msg import Odometry
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from visualization_msgs.msg import MarkerArray

from .boxes import boxes_from_message, BOXES_TOPIC
from .common import (Diagnostics, image_message, PAIR_TOPIC, Parameters, qos_options, RELIABLE,
                     run, stamp_ns)
from .messages import deletions, markers, odometry, path_markers
from .pair import pair_from_message
from ..core.config import ConfigRecord, TrackerConfig
from ..core.errors import CalibrationError, InputError
from ..core.records import PassResult, StereoPair, TrackUpdate
from ..core.units import KMH_MPS, MPH_MPS
from ..detection.protocol import ImageBox, TakesBoxes
from ..geometry.rig import StereoRig
from ..io.camera_info import rig_from_info, same_calibration
from ..pipeline.assembly import MeasuringSite
from ..pipeline.config import PipelineConfig, SiteConfig
from ..pipeline.pipeline import SpeedPipeline
from ..pipeline.registry import DETECTORS, TRACKERS
from ..report.overlay import draw
from ..site.file import load_site
from ..site.init_file import load_init
from ..site.refine.report import report, summary_lines
from ..steadying.report import steadiness_summary, warning

_WAITING_PAIRS = 50  # pairs kept until both calibrations have come
MOST_REFINE_PAIRS = 200


class TrackerNode(Node):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__('tracker_node')
        p = Parameters(self)
        site = p.get('site', '', 'path of the site file')
        self.init_path = p.get('init', '', 'path of an init file that marks the vehicles; '
                               'without it they are found automatically')
        self.seed = p.get('seed', 0, 'seed of all randomness', 0, 2 ** 31 - 1)
        tracker = p.get('tracker', 'constrained', 'tracker: ' + ', '.join(TRACKERS.names))
        detector = p.get('detector', 'plane_sweep',
                         'finds the vehicles: ' + ', '.join(DETECTORS.names))
        self.refine_pairs = p.get('refine_site_pairs', 0, 'refine the site by the images of the '
                                  'first so many pairs, which takes seconds; 0 takes it as it is',
                                  0, MOST_REFINE_PAIRS)
        where = f'{self.get_name()}: parameter'
        if not site:
            raise InputError(where, 'site', 'nothing', 'the path of the site file')
        self.config = self._config(p, tracker, detector, where)
        # Files of parameters have those of every tracker and detector.
        self.unused_parameters = tuple(
            f'{registry.kind}s.{name}.' for registry in (TRACKERS, DETECTORS)
            for name in registry.names if name not in (tracker, detector))
        self.site = load_site(site)
        self.annotations = load_init(self.init_path) if self.init_path else None
        self.infos: dict[str, CameraInfo] = {}
        self.pipeline: Optional[SpeedPipeline] = None
        self.waiting: deque[Image] = deque()
        self.boxes: deque[tuple[int, list[ImageBox]]] = deque(maxlen=_WAITING_PAIRS)
        self.rig: Optional[StereoRig] = None
        self.index, self.last_ns = 0, -1
        self.resets = self.repeated = self.passes = 0
        self._publish_and_subscribe()
        self.diagnostics = Diagnostics(self, self.state)

    @staticmethod
    def _config(p: Parameters, tracker: str, detector: str, where: str) -> PipelineConfig:
        """
        Return the parameters, those of the chosen tracker and detector among them.

        :raises InputError: an unknown name, a value out of bounds.
        """
        settings: dict[str, dict[str, ConfigRecord]] = {}
        for registry, name in ((TRACKERS, tracker), (DETECTORS, detector)):
            registry.check(name, where)
            kind = type(registry.settings(name, {}, where))
            settings[registry.kind] = {name: p.config(kind, f'{registry.kind}s.{name}.')}
        return PipelineConfig(
            p.config(TrackerConfig), tracker, detector, trackers=settings['tracker'],
            detectors=settings['detector'], site=p.config(SiteConfig))

    def _publish_and_subscribe(self) -> None:
        options = {'qos_overriding_options': qos_options()}
        self.tracks = self.create_publisher(Odometry, 'tracks', RELIABLE, **options)
        self.marker_array = self.create_publisher(MarkerArray, 'markers', RELIABLE, **options)
        self.overlay = self.create_publisher(Image, 'overlay/image_raw', RELIABLE, **options)
        self.create_subscription(Image, PAIR_TOPIC, self.on_pair, RELIABLE, **options)
        if hasattr(DETECTORS.load(self.config.detector), 'offer'):
            self.create_subscription(PointCloud2, BOXES_TOPIC, self.on_boxes, RELIABLE, **options)
        for side, callback in (('left', self.on_left_info), ('right', self.on_right_info)):
            self.create_subscription(CameraInfo, f'{side}/camera_info', callback,
                                     qos_profile_sensor_data, **options)

    # -- input ----------------------------------------------------------------------------

    def on_left_info(self, msg: CameraInfo) -> None:
        """Take the left calibration."""
        self.on_info('left', msg)

    def on_right_info(self, msg: CameraInfo) -> None:
        """Take the right calibration."""
        self.on_info('right', msg)

    def on_info(self, side: str, msg: CameraInfo) -> None:
        """
        Take a calibration; with both, the rig is known.

        :raises InputError: a calibration, site or mark that cannot be used, or another
            calibration than before.
        """
        known = self.infos.setdefault(side, msg)
        if not same_calibration(known, msg):
            raise CalibrationError(f'{side}/camera_info', 'calibration', 'another one',
                                   'the one measuring began with; start the node anew')
        if self.rig is None and len(self.infos) == 2:
            self.rig = rig_from_info(self.infos['left'], self.infos['right'], 'camera_info')
            self.begin()

    def on_pair(self, msg: Image) -> None:
        """Take a pair, or keep it until there is all it takes to measure."""
        if self.pipeline is not None:
            self.process(self.pipeline, msg)
            return
        if self.rig is None and len(self.waiting) == _WAITING_PAIRS:
            raise InputError(self.get_name(), 'left/camera_info and right/camera_info',
                             f'{sorted(self.infos) or "neither"} after {_WAITING_PAIRS} '
                             'pairs', 'both calibrations')
        if self.waiting and stamp_ns(msg.header.stamp) <= stamp_ns(self.waiting[-1].header.stamp):
            self.get_logger().warning('stamps jumped back: waiting anew')
            self.waiting.clear()
        self.waiting.append(msg)
        self.begin()

    def on_boxes(self, msg: PointCloud2) -> None:
        """
        Take the boxes that another node found in a left image, or keep them until there is a use.

        :raises InputError: a message that holds no boxes.
        """
        self.boxes.append((stamp_ns(msg.header.stamp), boxes_from_message(msg)))
        self.offer_boxes()

    def offer_boxes(self) -> None:
        """Give the detector the boxes that have come."""
        detector = None if self.pipeline is None else self.pipeline.detector
        while isinstance(detector, TakesBoxes) and self.boxes:
            detector.offer(*self.boxes.popleft())

    def begin(self) -> None:
        """Make the pipeline once the rig is known, and the pairs to refine the site have come."""
        if self.rig is None or len(self.waiting) < self.refine_pairs:
            return
        place = MeasuringSite.of(self.site, self.rig, [
            pair_from_message(msg, k) for k, msg in enumerate(self.waiting)
        ] if self.refine_pairs else None, self.config.site)
        if place.refined is not None:
            for line in summary_lines(place.refined, report(place.refined)):
                self.get_logger().info(line)
        if place.not_refined:
            self.get_logger().warning(
                f'site not refined, measured as it was read: {place.not_refined}')
        self.pipeline = place.pipeline(self.config, self.annotations, seed=self.seed,
                                       where=self.init_path)
        self.offer_boxes()
        while self.waiting:
            self.process(self.pipeline, self.waiting.popleft())

    # -- measuring ------------------------------------------------------------------------

    def process(self, pipeline: SpeedPipeline, msg: Image) -> None:
        """Run the pipeline on a pair and publish what it says."""
        ns = stamp_ns(msg.header.stamp)
        if ns == self.last_ns:
            self.repeated += 1
            return
        if ns < self.last_ns:
            self.start_anew(pipeline, ns)
        pair = pair_from_message(msg, self.index)
        self.index, self.last_ns = self.index + 1, ns
        step = pipeline.process(pair)
        frame_id = pipeline.rig.frame_id
        for update in step.updates:
            self.tracks.publish(odometry(update, frame_id))
        drawn = [m for u in step.updates for m in markers(u, frame_id)]
        drawn += path_markers(pipeline.lanes, ns, frame_id)
        for result in step.passes:
            drawn += deletions(result.track, frame_id)
            self.tell(result)
        self.marker_array.publish(MarkerArray(markers=drawn))
        self._publish_overlay(pipeline, pair, step.updates)

    def _publish_overlay(self, pipeline: SpeedPipeline, pair: StereoPair,
                         updates: list[TrackUpdate]) -> None:
        if self.overlay.get_subscription_count():  # drawing costs more than tracking
            image = draw(pair, updates, pipeline.lanes, pipeline.rig)
            self.overlay.publish(image_message(image, ns=pair.stamp_ns,
                                               frame_id=pipeline.rig.frame_id))

    def start_anew(self, pipeline: SpeedPipeline, ns: int) -> None:
        """End all passes and count pairs from 0: time has jumped back."""
        self.get_logger().warning(
            f'stamps jumped back from {self.last_ns} to {ns} ns: starting anew')
        for result in pipeline.finish():
            self.tell(result)
        pipeline.reset()
        self.index, self.last_ns = 0, -1
        self.resets += 1

    def tell(self, result: PassResult) -> None:
        """Log the result of a pass."""
        self.passes += 1
        speed = 'no speed' if result.speed_mps is None or result.speed_std_mps is None else (
            f'{result.speed_mps / MPH_MPS:.2f} ± {result.speed_std_mps / MPH_MPS:.2f} mph '
            f'({result.speed_mps / KMH_MPS:.2f} km/h)')
        self.get_logger().info(f'vehicle_{result.track} on {result.lane}: {speed}, '
                               f'{result.pairs} pairs, {result.verdict.value} {result.reason}')

    def close(self) -> None:
        """End the passes that are still open: the node stops."""
        if self.waiting and rclpy.ok():
            self.get_logger().warning(
                f'{len(self.waiting)} pairs were never measured: {self.state()[1]}')
        if self.pipeline is not None and rclpy.ok():
            for result in self.pipeline.finish():
                self.tell(result)

    def state(self) -> tuple[bytes, str, dict[str, Any]]:
        """Level, message and counts for ``/diagnostics``."""
        counts = {'pairs': self.index, 'passes': self.passes, 'resets': self.resets,
                  'repeated': self.repeated, 'waiting': len(self.waiting)}
        if self.pipeline is None:
            return b'\x01', ('waiting for camera_info' if self.rig is None
                             else 'waiting to refine the site'), counts
        steadier = self.pipeline.steadier
        if steadier is None:
            return b'\x00', 'measuring', counts
        rig = {f'rig_{key}': value for key, value in steadiness_summary(steadier.state()).items()}
        wrong = warning(steadier)
        return (b'\x01' if wrong else b'\x00'), wrong or 'measuring', {**counts, **rig}


def main(args: Optional[Sequence[str]] = None) -> int:
    """Run the node."""
    return run(TrackerNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
