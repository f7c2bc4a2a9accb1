# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Subscriptions that adapt to the publishers: reliable if these are, best effort otherwise.

A reliable subscription receives nothing from a best-effort publisher, and a best-effort one loses
large images of a reliable publisher. So the subscription begins with best effort, which is
compatible with all publishers, unless all known publishers of its topic are reliable, and becomes
reliable as soon as all are.
"""
from __future__ import annotations

from collections import deque
from typing import Any, Callable, Optional

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import CompressedImage, Image

from .common import Parameters, qos_options, RELIABLE
from ..core.errors import InputError

_DEPTH = RELIABLE.depth  # 2.5 s of images at 20 Hz, for a node that a busy machine holds up
_CHECK_S = 0.2  # interval at which publishers are checked


def image_kind(p: Parameters) -> tuple[type, str]:
    """
    Declare ``image_transport``; return the class of image messages and the suffix of their topic.

    :raises InputError: the value is neither raw nor compressed.
    """
    transport = p.get('image_transport', 'raw', "'raw' or 'compressed' images")
    if transport not in ('raw', 'compressed'):
        raise InputError(f'{p.node.get_name()}: parameter', 'image_transport', transport,
                         'raw or compressed')
    return (Image, '') if transport == 'raw' else (CompressedImage, '/compressed')


class OfferedSubscription:
    """
    See the module's docstring.

    When the reliability changes, the former subscription is kept until the new one receives its
    first message, so that no message is lost in between.  The parameter
    ``qos_overrides.TOPIC.subscription.reliability``, if given, takes precedence.

    :param node: the node that subscribes.
    :param kind: class of the messages.
    :param topic: name of the topic, usually relative.
    :param callback: called with each message.
    :param depth: number of messages kept until the node takes them; then the oldest are lost.
    """

    def __init__(self, node: Node, kind: type, topic: str, callback: Callable[[Any], None],
                 depth: int = _DEPTH) -> None:
        self.node, self.kind, self.topic, self.callback = node, kind, topic, callback
        self.resolved = node.resolve_topic_name(topic)
        self._former: Optional[Subscription] = None
        self._known: deque[Any] = deque(maxlen=depth)  # messages that it has received since
        self.subscription: Subscription = node.create_subscription(
            kind, topic, self._take,
            QoSProfile(depth=depth, reliability=_reliability(self._all_reliable())),
            qos_overriding_options=qos_options())
        self._check_timer: Optional[Timer] = None
        override = f'qos_overrides.{self.resolved}.subscription.reliability'
        if override not in node._parameter_overrides:  # rclpy has no public access to them
            self._check_timer = node.create_timer(_CHECK_S, self.adapt,
                                                  clock=Clock(clock_type=ClockType.STEADY_TIME))

    def close(self) -> None:
        """Unsubscribe."""
        if self._check_timer is not None:
            self.node.destroy_timer(self._check_timer)
        self._end_former()
        self.node.destroy_subscription(self.subscription)

    @property
    def reliable(self) -> bool:
        """Return whether it is a reliable subscription now."""
        return bool(self.subscription.qos_profile.reliability is ReliabilityPolicy.RELIABLE)

    def _all_reliable(self) -> Optional[bool]:
        """Return whether all publishers are reliable; None where there are none."""
        offered = [p.qos_profile.reliability
                   for p in self.node.get_publishers_info_by_topic(self.resolved)]
        return all(r is ReliabilityPolicy.RELIABLE for r in offered) if offered else None

    def adapt(self) -> None:
        """Subscribe again if the publishers' reliability has changed."""
        wanted = self._all_reliable()
        if wanted is None or wanted == self.reliable:
            return
        qos, last = self.subscription.qos_profile, self.subscription
        if self._former is not None:  # it has the wanted reliability
            self.subscription, self._former = self._former, None
            self._known.clear()
            self.subscription.callback = self._take
            self.node.destroy_subscription(last)
            return
        self._former = last
        self._known.clear()
        last.callback = self._take_former
        self.subscription = self.node.create_subscription(
            self.kind, self.topic, self._take, QoSProfile(
                history=qos.history, depth=qos.depth, durability=qos.durability,
                reliability=_reliability(wanted)))

    def _take(self, msg: Any) -> None:
        """Handle a message, unless the former subscription has received it already."""
        self._end_former()
        if msg in self._known:  # and those before it, as messages come in the order of sending
            while self._known.popleft() != msg:
                pass
            return
        if self._known:  # one that the former has lost; what it knew is soon of no use
            self._known.popleft()
        self.callback(msg)

    def _take_former(self, msg: Any) -> None:
        """Handle a message of the former subscription."""
        self._known.append(msg)
        self.callback(msg)

    def _end_former(self) -> None:
        former, self._former = self._former, None
        if former is not None:
            self.node.destroy_subscription(former)


def _reliability(reliable: Optional[bool]) -> ReliabilityPolicy:
    """Return the policy of a subscription; ``reliable`` is None while no publisher is known."""
    return ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
