# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``replay_node``: plays a bag as the camera pair would.

Images keep their header stamps and are published in recorded order, at the pace of their stamps
times ``rate``, each after a ``/clock`` message with its stamp.  A ``camera_info`` is published
with the image that follows it, whatever its stamp; with ``start``, so are the last ones before it.
"""
from __future__ import annotations

from contextlib import closing
from functools import partial
import time
from typing import Any, Iterator, NamedTuple, Optional

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from .common import byte_array, image_message, Parameters, qos_options, RELIABLE, run, to_stamp
from ..core.errors import BagError, InputError
from ..io.ahead import ahead
from ..io.bags import BagMessage, StereoBag
from ..io.images import grey_from_message

_ACK_WAIT = Duration(seconds=10)
_POLL_S = 0.02
_JUMP_NS = 10_000_000_000  # least change of stamps from one image to the next that is a jump
_SETTLE_S = 0.5  # time without a new connection after which all have been discovered


class _Pace:
    """
    The times of images since the first one: by their stamps, which cameras set at the exposure.

    Where a stamp jumps, as one that is wrong does, it is by the times at which they were recorded.

    :param time_s: time of the last image, s.
    :param clock_ns: latest stamp up to then, for ``/clock``, without those at which time jumped.
    """

    def __init__(self) -> None:
        self.time_s, self.clock_ns = 0.0, 0
        self._last: Optional[BagMessage] = None
        self._at_ns = 0

    def take(self, image: BagMessage) -> None:
        """Go on to the next image."""
        last, self._last = self._last or image, image
        step_ns = image.stamp_ns - last.stamp_ns
        recorded_ns = max(image.log_time_ns - last.log_time_ns, 0)
        steady, paused = (abs(ns) <= _JUMP_NS for ns in (step_ns, step_ns - recorded_ns))
        if steady or paused:
            self.clock_ns = max(self.clock_ns, image.stamp_ns)
        self._at_ns += step_ns if steady else recorded_ns
        self.time_s = self._at_ns * 1e-9


class _Due(NamedTuple):
    """
    A message that is ready to be published.

    :param due_s: time since ``start`` at which it is due, s.
    :param clock_ns: time that is published on ``/clock`` before it; 0 for none.
    :param message: the message in the bag.
    :param msg: the same as one of rclpy.
    """

    due_s: float
    clock_ns: int
    message: BagMessage
    msg: Any


class ReplayNode(Node):
    """See the module's docstring."""

    def __init__(self, name: str = 'replay_node') -> None:
        super().__init__(name)
        p = Parameters(self)
        bag = p.get('bag', '', 'rosbag2 folder, .mcap or .db3 file, or ROS 1 .bag')
        left, right = (p.get(f'{side}_topic', '', f'topic of the {side} images in the bag; '
                             'empty: found by type and name') for side in ('left', 'right'))
        self.rate = p.get('rate', 1.0, 'speed of the replay; 2 is twice as fast as recorded',
                          0.01, 100.0)
        self.start_s = p.get('start', 0.0, 'seconds that are left out at the start of the bag',
                             0.0, 1e9)
        self.loop = p.get('loop', False, 'play the bag endlessly')
        self.decode = p.get('decode', True, 'publish compressed images as raw grey ones; false '
                            'to publish them as recorded, on image_raw/compressed')
        self.wait = p.get('wait_for_subscribers', True,
                          'begin only when images and camera_info have subscribers')
        self.wait_for = p.get('wait_for_topics', '', 'topics between other nodes, separated by '
                              'blanks, that must have a publisher and a subscriber before the '
                              'replay begins, such as stereo/image_pair and tracks').split()
        self.wait_s = p.get('wait_timeout', 60.0, 'longest wait for subscribers [s]', 0.0, 3600.0)
        if not bag:
            raise InputError(f'{self.get_name()}: parameter', 'bag', 'nothing', 'a bag')
        self.bag = StereoBag(bag, left or None, right or None)
        self.bag.__enter__()
        self.clock = self.create_publisher(Clock, '/clock', 10)
        self.outputs = {(side, kind): self._publisher(side, kind)
                        for side in ('left', 'right') for kind in ('image', 'camera_info')}

    def _publisher(self, side: str, kind: str) -> Publisher:
        options = {'qos_overriding_options': qos_options()}
        if kind == 'camera_info':
            return self.create_publisher(CameraInfo, f'{side}/camera_info', RELIABLE, **options)
        topic = self.bag.topics.images[side == 'right']
        if self.decode or not topic.endswith('/compressed'):
            return self.create_publisher(Image, f'{side}/image_raw', RELIABLE, **options)
        return self.create_publisher(CompressedImage, f'{side}/image_raw/compressed', RELIABLE,
                                     **options)

    def play(self) -> None:
        """
        Play the bag, once or endlessly.

        :raises InputError: subscribers are missing for too long, or there is nothing to play.
        """
        if self.wait:
            self._wait_for_subscribers()
        while True:
            if not self._play_once():
                raise BagError(self.bag.path, 'messages', f'none after {self.start_s} s',
                               'a start within the bag')
            if not self.loop:
                break
        # Leave only after everything has arrived, or it would be lost with this process.
        for output in self.outputs.values():
            output.wait_for_all_acked(_ACK_WAIT)

    def _play_once(self) -> int:
        """Publish each message when it is due; return how many were published."""
        count, begun = 0, time.monotonic()
        with closing(ahead(self._due())) as all_due:
            for due in all_due:
                self._sleep_until(begun + due.due_s / self.rate)
                if due.clock_ns:
                    self.clock.publish(Clock(clock=to_stamp(due.clock_ns)))
                self.send(due.message.side, due.message.kind, due.msg, due.due_s)
                count += 1
        return count

    def _due(self) -> Iterator[_Due]:
        """Yield messages when they are due."""
        infos: list[BagMessage] = []  # since the last image
        pace, due_s, played = _Pace(), 0.0, False
        for message in self.messages():
            if message.kind == 'camera_info':
                infos.append(message)
                continue
            pace.take(message)
            due_s = pace.time_s - self.start_s
            if self.start_s and due_s < 0:
                infos = list({info.side: info for info in infos}.values())
                continue
            for info in infos:
                yield _Due(due_s, 0, info, self._message(info))
            yield _Due(due_s, pace.clock_ns, message, self._message(message))
            infos, played = [], True
        for info in infos if played else ():
            yield _Due(due_s, 0, info, self._message(info))

    def messages(self) -> Iterator[BagMessage]:
        """Yield the messages to play, in recorded order."""
        return self.bag.messages()

    def send(self, side: str, kind: str, msg: Any, due_s: float) -> None:
        """
        Publish a message.

        :param side: left or right.
        :param kind: image or camera_info.
        :param msg: the message, ready to be published.
        :param due_s: time since ``start`` in the bag, s.
        """
        self.outputs[side, kind].publish(msg)

    def _message(self, message: BagMessage) -> Any:
        """Return a message of the bag as one of rclpy."""
        if message.kind == 'camera_info':
            return _camera_info(message)
        header = message.msg.header
        if message.msgtype.endswith('/CompressedImage'):
            if self.decode:
                return image_message(grey_from_message(message.msg, message.topic),
                                     ns=message.stamp_ns, frame_id=header.frame_id)
            out = CompressedImage(format=message.msg.format)
        else:
            m = message.msg
            out = Image(height=m.height, width=m.width, encoding=m.encoding, step=m.step,
                        is_bigendian=int(m.is_bigendian))
        out.data = byte_array(message.msg.data)
        out.header.stamp, out.header.frame_id = to_stamp(message.stamp_ns), header.frame_id
        return out

    def _wait_for_subscribers(self) -> None:
        """
        Wait until all subscribers and the other topics are connected, and this does not change.

        Nodes are discovered one by one, so the first subscriber of a topic need not be the last.

        :raises InputError: a connection is missing for too long.
        """
        now = since = time.monotonic()
        end, known = now + self.wait_s, self._connections()
        while self._lonely() or min(since + _SETTLE_S, end) > now:
            if now > end:
                raise InputError(self.get_name(), 'subscribers', f'none on '
                                 f'{", ".join(self._lonely())} after {self.wait_s} s',
                                 'one on each topic')
            time.sleep(_POLL_S)
            now, connections = time.monotonic(), self._connections()
            if connections != known:
                known, since = connections, now

    def _lonely(self) -> list[str]:
        """Return the topics that lack a connected subscriber, or a publisher."""
        out = [o.topic_name for o in self.outputs.values()
               if not o.get_subscription_count()
               or o.get_subscription_count() < self.count_subscribers(o.topic_name)]
        return out + [topic for topic in self.wait_for
                      if not self.count_publishers(topic) or not self.count_subscribers(topic)]

    def _connections(self) -> list[int]:
        """Return the numbers of connections, to detect changes."""
        return [n for o in self.outputs.values()
                for n in (o.get_subscription_count(), self.count_subscribers(o.topic_name))] + [
            n for topic in self.wait_for
            for n in (self.count_publishers(topic), self.count_subscribers(topic))]

    @staticmethod
    def _sleep_until(due: float) -> None:
        left = due - time.monotonic()
        if left > 0:
            time.sleep(left)

    def close(self) -> None:
        """Close the bag."""
        if hasattr(self, 'bag'):
            self.bag.close()


def _camera_info(message: BagMessage) -> CameraInfo:
    """Return a copy of a calibration; ROS 1 bags name its matrices in capitals."""
    m = message.msg
    out = CameraInfo(height=m.height, width=m.width, distortion_model=m.distortion_model,
                     binning_x=m.binning_x, binning_y=m.binning_y)
    for name in 'dkrp':
        values = getattr(m, name) if hasattr(m, name) else getattr(m, name.upper())
        setattr(out, name, np.asarray(values, float) if name != 'd' else list(map(float, values)))
    for name in ('x_offset', 'y_offset', 'height', 'width', 'do_rectify'):
        setattr(out.roi, name, getattr(m.roi, name))
    out.header.stamp, out.header.frame_id = to_stamp(message.stamp_ns), m.header.frame_id
    return out


main = partial(run, ReplayNode, spin=ReplayNode.play)

if __name__ == '__main__':
    raise SystemExit(main())
