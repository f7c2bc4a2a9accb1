# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions are compatible with the publishers of their topics."""
from __future__ import annotations

import pytest

pytest.importorskip('rclpy')

import rclpy  # noqa: E402, I100
from rclpy.duration import Duration  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from stereo_speed.nodes.common import RELIABLE  # noqa: E402
from stereo_speed.nodes.subscriptions import OfferedSubscription  # noqa: E402

EVENT_S = 20.0
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


def test_subscription_is_reliable_if_all_publishers_are_and_receives_from_all(stand_in):
    heard = []
    subscription = OfferedSubscription(stand_in, String, 'offered', heard.append)

    def hears(publisher, text):
        stand_in.wait(publisher.get_subscription_count, EVENT_S)
        publisher.publish(String(data=text))
        stand_in.wait(lambda: heard and heard[-1].data == text, EVENT_S)
    assert not subscription.reliable  # compatible with all publishers while none is known
    reliable = stand_in.create_publisher(String, 'offered', RELIABLE)
    stand_in.wait(lambda: subscription.reliable, EVENT_S)
    hears(reliable, 'one')
    other = stand_in.create_publisher(String, 'offered', BEST_EFFORT)
    stand_in.wait(lambda: not subscription.reliable, EVENT_S)
    hears(other, 'two')
    hears(reliable, 'three')
    stand_in.destroy_publisher(other)
    stand_in.wait(lambda: subscription.reliable, EVENT_S)
    hears(reliable, 'four')
    assert [message.data for message in heard] == ['one', 'two', 'three', 'four']
    subscription.close()


def test_no_message_is_lost_or_told_twice_while_it_becomes_reliable(stand_in):
    """The publisher goes on while the subscription is exchanged, which both may bring one of."""
    heard, sent = [], []
    subscription = OfferedSubscription(stand_in, String, 'offered', heard.append)
    publisher = stand_in.create_publisher(String, 'offered', RELIABLE)

    def publish():
        sent.append(f'{len(sent)}')
        publisher.publish(String(data=sent[-1]))
    stand_in.wait(publisher.get_subscription_count, EVENT_S)  # of the one by best effort
    timer = stand_in.create_timer(0.005, publish)
    stand_in.wait(lambda: subscription.reliable, EVENT_S)
    known = len(heard)
    stand_in.wait(lambda: publisher.get_subscription_count() == 1 and len(heard) > known + 50,
                  EVENT_S)
    stand_in.destroy_timer(timer)
    stand_in.wait(lambda: heard[-1].data == sent[-1], EVENT_S)
    told = [int(message.data) for message in heard]
    assert told == list(range(told[0], len(sent)))
    subscription.close()


def test_a_node_that_stands_still_for_seconds_loses_nothing(stand_in):
    """Forty images, as of two seconds, come while nothing is taken."""
    heard = []
    publisher = stand_in.create_publisher(String, 'offered', RELIABLE)
    stand_in.wait(lambda: stand_in.count_publishers('offered'), EVENT_S)
    subscription = OfferedSubscription(stand_in, String, 'offered', heard.append)
    stand_in.wait(publisher.get_subscription_count, EVENT_S)
    for n in range(40):
        publisher.publish(String(data=f'{n}'))
    assert publisher.wait_for_all_acked(Duration(seconds=EVENT_S))
    stand_in.wait(lambda: len(heard) == 40, EVENT_S)
    assert [message.data for message in heard] == [f'{n}' for n in range(40)]
    subscription.close()


@pytest.mark.parametrize('former, new, told', [
    ('123', '12345', '12345'), ('123', '345', '12345'), ('123', '2345', '12345'),
    ('123', '45', '12345'), ('134', '2345', '13425')])
def test_what_both_subscriptions_bring_is_told_once(stand_in, former, new, told):
    """The new one may begin with any message of the former one, or with one that that has lost."""
    heard = []
    subscription = OfferedSubscription(stand_in, String, 'offered', heard.append)
    publisher = stand_in.create_publisher(String, 'offered', RELIABLE)
    stand_in.wait(lambda: subscription.reliable, EVENT_S)
    for text in former:
        subscription._take_former(String(data=text))
    for text in new:
        subscription._take(String(data=text))
    assert [message.data for message in heard] == list(told)
    subscription.close()
    stand_in.destroy_publisher(publisher)


@pytest.mark.parametrize('given', ['reliable', 'best_effort'])
def test_configured_reliability_is_kept(stand_in, given):
    node = rclpy.create_node('given', context=stand_in.context, parameter_overrides=[Parameter(
        'qos_overrides./offered.subscription.reliability', value=given)])
    subscription = OfferedSubscription(node, String, '/offered', print)
    stand_in.create_publisher(
        String, '/offered', BEST_EFFORT if given == 'reliable' else RELIABLE)
    stand_in.wait(lambda: node.count_publishers('/offered') == 1, EVENT_S)
    assert not list(node.timers)  # that would check the offered QoS
    assert subscription.reliable == (given == 'reliable')
    node.destroy_node()
