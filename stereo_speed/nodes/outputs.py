# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The publishers of measuring nodes: tracks, speeds, passes, markers, frames and the overlay."""
from __future__ import annotations

from dataclasses import replace
import threading
import time
from typing import Any, Mapping, Optional, Sequence

from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from .common import LATCHED, latched_options, LATEST, Parameters, qos_options, RELIABLE
from .frames import StaticFrames
from .messages import deletions, markers, odometry, path_markers
from .overlay import Overlay
from .speeds import speed_of
from ..core.passes import PassResult
from ..core.records import StereoPair, TrackUpdate
from ..core.units import KMH_MPS, MPH_MPS
from ..enforcement.instrument import Instrument
from ..io.pass_json import new_run, pass_text, track_states_text
from ..io.trace_json import trace_text
from ..pipeline.assembly import MeasuringSite
from ..pipeline.config import PipelineConfig
from ..pipeline.pipeline import SpeedPipeline, Step

_ACK_WAIT = Duration(seconds=1)  # time for delivery of the last passes when the node stops
_LEAST_LIFETIME_S, _LIFETIME_INTERVALS = 0.5, 2.5  # lifetime of markers: least, and in intervals
_STATIC_WAIT_S = 1.0  # longest time that static messages wait until no pair is queued


class Outputs:
    """
    The publishers of a measuring node.

    :param node: the node.
    :param p: declares the parameters.
    :param speeds: whether to publish ``vehicle_speed`` too, as ``speed_node`` does.
    """

    def __init__(self, node: Node, p: Parameters, *, speeds: bool = False) -> None:
        self.log, self.run = node.get_logger(), new_run()
        self._frames = StaticFrames(node, p)
        self._overlay = Overlay(node, p, self._frames.right)
        self._last_ns = 0
        self._readings: set[tuple[int, int]] = set()  # published ones of a pair: stamp and track
        # The instrument is published by two threads, of measuring and of self-tests.
        self._telling = threading.Lock()
        self._instrument: Optional[Instrument] = None
        # The arguments of ``begin``, until ``publish_static`` has used them.
        self._unpublished: Optional[tuple[SpeedPipeline, MeasuringSite, PipelineConfig]] = None
        self._begun_s = 0.0  # steady time of ``begin``
        self._self_test: Optional[Mapping[str, Any]] = None

        def publisher(kind: type, topic: str) -> Any:
            return node.create_publisher(kind, topic, RELIABLE,
                                         qos_overriding_options=qos_options())
        self.tracks = publisher(Odometry, 'tracks')
        self.track_states = publisher(String, 'track_states')
        self.speeds = publisher(TwistWithCovarianceStamped, 'vehicle_speed') if speeds else None
        self.passes, self.traces, self.instrument = (node.create_publisher(
            String, topic, LATCHED, qos_overriding_options=latched_options())
            for topic in ('passes', 'pass_traces', 'instrument'))
        self.markers = node.create_publisher(
            MarkerArray, 'markers', RELIABLE, qos_overriding_options=qos_options())
        self.paths = node.create_publisher(
            MarkerArray, 'lane_markers', LATEST, qos_overriding_options=latched_options())

    def begin(self, pipeline: SpeedPipeline, place: MeasuringSite, config: PipelineConfig
              ) -> None:
        """
        Note the pipeline that ``publish_static`` is to describe.

        :param pipeline: the pipeline that measures from now on.
        :param place: the site that is measured at.
        :param config: the parameters.
        """
        self._unpublished, self._begun_s = (pipeline, place, config), time.monotonic()

    @property
    def static_is_overdue(self) -> bool:
        """Return whether ``publish_static`` must be called now, even if pairs are queued."""
        return self._unpublished is not None \
            and time.monotonic() - self._begun_s > _STATIC_WAIT_S

    def publish_static(self) -> None:
        """
        Publish what does not change during a pipeline: the instrument, the lanes and the frames.

        It is published once for each pipeline.  That takes as long as two pairs, so it should be
        done while no pair is queued, because readings come first.
        """
        unpublished, self._unpublished = self._unpublished, None
        if unpublished is None:
            return
        pipeline, place, config = unpublished
        with self._telling:
            self._tell_instrument(Instrument.of(self.run, place, config))
        self.paths.publish(MarkerArray(markers=path_markers(
            pipeline.lanes, pipeline.rig.frame_id)))
        self._frames.publish(pipeline.rig, pipeline.lanes)

    def tell_self_test(self, newest: Optional[Mapping[str, Any]]) -> None:
        """Publish the instrument again if a self-test has passed since; see ``Instrument``."""
        with self._telling:
            if newest is self._self_test:
                return
            self._self_test = newest
            if self._instrument is not None:
                self._tell_instrument(self._instrument)

    def _tell_instrument(self, instrument: Instrument) -> None:
        self._instrument = replace(instrument, self_test=self._self_test)
        self.instrument.publish(String(data=self._instrument.text()))

    def tell_readings(self, pipeline: SpeedPipeline, updates: Sequence[TrackUpdate]) -> None:
        """Publish some tracks of a pair, before the others may be known."""
        for update in updates:
            track = odometry(update, pipeline.rig.frame_id)
            self.tracks.publish(track)
            speed = speed_of(track)
            if self.speeds is not None and speed is not None:
                self.speeds.publish(speed)
        self._readings |= {(u.stamp_ns, u.track) for u in updates}

    def tell(self, pipeline: SpeedPipeline, pair: StereoPair, step: Step) -> None:
        """Publish the results of a pair, except readings that were published before."""
        frame_id = pipeline.rig.frame_id
        self.tell_readings(pipeline, [
            u for u in step.updates if (u.stamp_ns, u.track) not in self._readings])
        self._readings = set()
        self.track_states.publish(String(data=track_states_text(self.run, pair, step.updates)))
        interval_s = max(pair.stamp_ns - self._last_ns, 0) * 1e-9 if self._last_ns else 0.0
        lifetime_s = max(_LEAST_LIFETIME_S, _LIFETIME_INTERVALS * interval_s)
        self._last_ns = pair.stamp_ns
        if step.updates and self.markers.get_subscription_count():
            self.markers.publish(MarkerArray(markers=[
                m for u in step.updates for m in markers(u, frame_id, lifetime_s)]))
        self._overlay.show(pipeline, pair, step.updates)
        self.end(pipeline, step.passes)

    def end(self, pipeline: SpeedPipeline, results: Sequence[PassResult]) -> None:
        """Publish and log passes that are over, and delete their markers."""
        for result in results:
            if self.traces.get_subscription_count():  # large, and needed for evidence only
                self.traces.publish(String(data=trace_text(self.run, result)))
            self.passes.publish(String(data=pass_text(self.run, result)))
            self.log.info(_line(result))
        gone = [m for r in results for m in deletions(r.track, pipeline.rig.frame_id)]
        if gone:
            self.markers.publish(MarkerArray(markers=gone))

    def wait(self) -> None:
        """Wait until the last passes and traces have reached all subscribers."""
        for publisher in (self.passes, self.traces):
            publisher.wait_for_all_acked(_ACK_WAIT)

    def close(self) -> None:
        """End the thread that draws, because the node stops."""
        self._overlay.close()


def _line(result: PassResult) -> str:
    """Return a pass as a line of text for the log."""
    speed = 'no speed' if result.speed_mps is None or result.speed_std_mps is None else (
        f'{result.speed_mps / MPH_MPS:.2f} ± {result.speed_std_mps / MPH_MPS:.2f} mph '
        f'({result.speed_mps / KMH_MPS:.2f} km/h)')
    return (f'vehicle_{result.track} on {result.lane}: {speed}, {result.pairs} pairs, '
            f'{result.verdict.value} {result.reason}')
