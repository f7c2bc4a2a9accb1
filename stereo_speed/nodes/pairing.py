# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Two image streams in, pairs out; shared by ``stereo_sync_node`` and ``speed_camera_node``.

No message can stop it: an image that cannot be used is refused, counted and reported on
``/diagnostics``.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Callable

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo

from .common import JUMP_NS, Parameters, stamp_ns
from .diagnostics import Task
from .health import Arrivals, ERROR, Look, Refusals, StampGaps, State, Tally, WARN
from .pair import Grey
from .subscriptions import image_kind, OfferedSubscription
from ..core.errors import CalibrationError, InputError
from ..core.pair_matcher import PairMatcher
from ..io.images import grey_from_message
from ..io.topics import SIDES

_STUCK = 5  # equal stamps in a row from which on the clock counts as standing still


@dataclass(frozen=True, eq=False)
class ImagePair:
    """
    Two images that belong together.

    :param left_ns: header stamp of the left image, ns.
    :param right_ns: header stamp of the right image, ns.
    :param left: (H, W) raw grey pixels.
    :param right: (H, W), of the same size and type.
    :param frame_id: frame of the left image.
    """

    left_ns: int
    right_ns: int
    left: Grey
    right: Grey
    frame_id: str


class _Side:
    """The state of one camera's stream."""

    def __init__(self) -> None:
        self.arrivals, self.look, self.gaps = Arrivals(), Look(), StampGaps()
        self.lost, self.repeated, self.unpaired = Tally(), Tally(), Tally()
        self.size: tuple[int, int] = (0, 0)  # height and width of the calibration; 0 if unknown
        self.last_ns, self.stuck = -1, 0


class Pairing:
    """
    Pairs the images of both cameras, from ``subscribe`` to ``close``.

    :param node: the node that subscribes.
    :param p: declares the parameters.
    :param give: called with each pair.
    :param infos: whether to subscribe to calibrations; False where the node does so and calls
        ``on_info``.
    """

    def __init__(self, node: Node, p: Parameters, give: Callable[[ImagePair], None], *,
                 infos: bool = True) -> None:
        where = f'{node.get_name()}: parameter'
        kind, suffix = image_kind(p)
        approximate = p.get('approximate_sync', False,
                            'pair the nearest stamps within a tolerance instead of equal ones')
        tolerance_s = p.get('approximate_sync_tolerance_seconds', 0.0,
                            'largest gap between the stamps of a pair [s]', 0.0, 1.0)
        queue = p.get('queue_size', 10, 'unpaired images kept per side', 1, 1000)
        tolerance_ns = round(tolerance_s * 1e9)
        if approximate and not tolerance_ns:
            raise InputError(where, 'approximate_sync_tolerance_seconds', tolerance_s,
                             'more than 0 with approximate_sync, less than half the time '
                             'between two images')
        self.node, self.give = node, give
        self.matcher = PairMatcher(tolerance_ns if approximate else 0, queue)
        self.refusals = Refusals(node.get_logger().warning)
        self._kind, self._suffix, self._infos = kind, suffix, infos
        self.subscriptions: list[OfferedSubscription] = []
        self.resets = 0
        self._begin_anew()

    def _begin_anew(self) -> None:
        self.matcher.reset()
        self.sides, self.pairs = {side: _Side() for side in SIDES}, Arrivals()
        self._known_unpaired = dict.fromkeys(SIDES, 0)

    def subscribe(self) -> None:
        """Subscribe to the cameras."""
        self._begin_anew()
        self.subscriptions = [
            OfferedSubscription(self.node, what, f'{side}/{topic}', partial(callback, side))
            for side in SIDES for what, topic, callback in (
                (self._kind, f'image_raw{self._suffix}', self.on_image),
                *([(CameraInfo, 'camera_info', self.on_info)] if self._infos else []))]

    def close(self) -> None:
        """Unsubscribe from the cameras."""
        for subscription in self.subscriptions:
            subscription.close()
        self.subscriptions = []

    @property
    def tasks(self) -> dict[str, Task]:
        """Return the tasks reported on ``/diagnostics``, by name."""
        return {'left camera': partial(self._camera, 'left'),
                'right camera': partial(self._camera, 'right'), 'pairs': self._pairs}

    def on_info(self, side: str, msg: CameraInfo) -> None:
        """Keep the image size of a calibration, to check images against it."""
        self.sides[side].size = (msg.height, msg.width)

    def on_image(self, side: str, msg: Any) -> None:
        """Process an image; pass on the pairs that are now certain."""
        ns, of = stamp_ns(msg.header.stamp), self.sides[side]
        try:
            grey = self._grey(side, msg)
        except InputError as error:
            self.refusals.add(f'{side}/image_raw', error)
            if ns > of.last_ns:  # it came, so its stamp is not missing
                of.lost.add(of.gaps.add(ns))
            return
        of.arrivals.add()
        of.look.add(grey)
        if ns < of.last_ns - JUMP_NS:
            self._reset(side, ns)
        if ns <= of.last_ns:
            of.repeated.add()
            of.stuck += ns == of.last_ns
            return
        of.lost.add(of.gaps.add(ns))
        of.last_ns, of.stuck = ns, 0
        add = self.matcher.add_left if side == 'left' else self.matcher.add_right
        pairs = add(ns, (grey, msg.header.frame_id))
        for left_ns, (left, frame_id), right_ns, (right, _) in pairs:
            self._pair(ImagePair(left_ns, right_ns, left, right, frame_id))
        self._count_unpaired()

    def _grey(self, side: str, msg: Any) -> Grey:
        """
        Return the pixels of an image.

        :raises InputError: it cannot be decoded, or does not have the calibrated size.
        """
        topic, size = f'{side}/image_raw', self.sides[side].size
        grey = grey_from_message(msg, topic)
        if all(size) and grey.shape != size:
            raise CalibrationError(topic, 'image size', f'{grey.shape[1]}x{grey.shape[0]}',
                                   f'{size[1]}x{size[0]} as in {side}/camera_info')
        return grey

    def _pair(self, pair: ImagePair) -> None:
        left, right = pair.left, pair.right
        if left.shape != right.shape or left.dtype != right.dtype:
            self.refusals.add('pair', InputError(
                'right/image_raw', 'image', f'{right.shape[1]}x{right.shape[0]} {right.dtype}',
                f'{left.shape[1]}x{left.shape[0]} {left.dtype} as the left image'))
            return
        self.pairs.add()
        self.give(pair)

    def _count_unpaired(self) -> None:
        for side, count in (('left', self.matcher.unpaired_left),
                            ('right', self.matcher.unpaired_right)):
            tally = self.sides[side].unpaired
            tally.add(count - self._known_unpaired[side])
            self._known_unpaired[side] = count

    def _reset(self, side: str, ns: int) -> None:
        """Drop unpaired images, because time has jumped back."""
        self.node.get_logger().warning(f'{side} stamp jumped back from {self.sides[side].last_ns} '
                                       f'to {ns} ns: starting again')
        self.matcher.reset()
        self._known_unpaired = dict.fromkeys(SIDES, 0)
        for of in self.sides.values():
            of.last_ns, of.stuck = -1, 0
            of.gaps.restart()
        self.resets += 1

    # -- diagnostics ------------------------------------------------------------------------

    def _camera(self, side: str) -> State:
        of, state = self.sides[side], State('receiving images')
        if not self.subscriptions:
            state.find(WARN, 'inactive')
            return state
        of.arrivals.tell(state, f'{side} image', 'image')
        state.values.update(images=of.arrivals.tally.total, lost=of.lost.total,
                            repeated=of.repeated.total)
        if of.stuck >= _STUCK:
            state.find(ERROR, f'stamps of {side} images stand still at {of.last_ns} ns')
        elif of.repeated.recent:
            state.find(WARN, f'{of.repeated.recent} {side} images arrived twice or late')
        if of.lost.recent:
            state.find(WARN, f'{of.lost.recent} {side} images lost on the way: their stamps are '
                       'missing')
        of.look.tell(state, side)
        return state

    def _pairs(self) -> State:
        state = State('pairing')
        if not self.subscriptions:
            state.find(WARN, 'inactive')
            return state
        self.pairs.tell(state, 'pair', 'pair')
        left, right = (self.sides[side].unpaired for side in SIDES)
        state.values.update(pairs=self.pairs.tally.total, unpaired_left=left.total,
                            unpaired_right=right.total, resets=self.resets)
        if left.recent or right.recent:
            state.find(WARN, f'without a partner: {left.recent} left and {right.recent} right '
                       'images')
        self.refusals.tell(state)
        return state
