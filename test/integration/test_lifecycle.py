# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The lifecycle of a measuring node, driven by a lifecycle manager."""
from __future__ import annotations

import json
import signal

import pytest

pytest.importorskip('rclpy')

from lifecycle_msgs.msg import State, Transition  # noqa: E402, I100
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from stereo_speed.cli.demo import (  # noqa: E402
    EVERY_PAIR, Process, RELIABLE_IMAGES, RELIABLE_INFOS)

STARTUP_S, EVENT_S = 60.0, 120.0
CONFIGURE, ACTIVATE, DEACTIVATE, CLEANUP, SHUTDOWN = (
    Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE,
    Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP,
    Transition.TRANSITION_INACTIVE_SHUTDOWN)
UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = (
    State.PRIMARY_STATE_UNCONFIGURED, State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE,
    State.PRIMARY_STATE_FINALIZED)


class Manager:
    """Requests transitions and states, like ``ros2 lifecycle``."""

    def __init__(self, stand_in, name):
        self.node = stand_in
        self.clients = {kind: stand_in.create_client(kind, f'/{name}/{service}')
                        for kind, service in ((ChangeState, 'change_state'),
                                              (GetState, 'get_state'))}
        for client in self.clients.values():
            stand_in.wait(client.service_is_ready, STARTUP_S)

    def _ask(self, kind, request):
        future = self.clients[kind].call_async(request)
        self.node.wait(future.done, EVENT_S)
        return future.result()

    def change(self, transition):
        """Return whether the transition succeeded, and the state after it."""
        done = self._ask(ChangeState, ChangeState.Request(transition=Transition(id=transition)))
        return done.success, self.state

    @property
    def state(self):
        """Return the node's state."""
        return self._ask(GetState, GetState.Request()).current_state.id


def test_lifecycle_manager_can_start_stop_and_restart_measuring(stand_in, sample):
    from stereo_speed.nodes.common import LATCHED
    told = []
    stand_in.create_subscription(String, '/passes', lambda m: told.append(json.loads(m.data)),
                                 LATCHED)
    with Process('speed_camera_node', *RELIABLE_IMAGES, *RELIABLE_INFOS, *EVERY_PAIR,
                 f'site:={sample / "site.yaml"}', 'autostart:=false',
                 'silence_s:=3600') as node:
        manager = Manager(stand_in, 'speed_camera_node')
        assert manager.state == UNCONFIGURED
        assert stand_in.count_subscribers('/left/camera_info') == 0
        assert manager.change(ACTIVATE) == (False, UNCONFIGURED)  # there is no such transition
        assert manager.change(CONFIGURE) == (True, INACTIVE)
        stand_in.wait(lambda: stand_in.count_subscribers('/left/camera_info') == 1, EVENT_S)
        assert stand_in.count_subscribers('/left/image_raw') == 0
        for track in (0, 1):
            assert manager.change(ACTIVATE) == (True, ACTIVE)
            with Process('replay_node', f'bag:={sample / "bag"}', 'rate:=2') as replay:
                stand_in.wait(replay.ended, STARTUP_S)
            assert len(told) == track  # no pair shows yet that the vehicle has left
            assert manager.change(DEACTIVATE) == (True, INACTIVE)
            stand_in.wait(lambda: len(told) == track + 1, EVENT_S)
            stand_in.wait(lambda: stand_in.count_subscribers('/left/image_raw') == 0, EVENT_S)
        assert manager.change(CLEANUP) == (True, UNCONFIGURED)
        assert manager.change(CONFIGURE) == (True, INACTIVE)
        assert manager.change(SHUTDOWN) == (True, FINALIZED)
        node.process.send_signal(signal.SIGTERM)
        assert node.process.wait(EVENT_S) == 0
    assert [p['track'] for p in told] == [0, 1]
    assert len({p['run'] for p in told}) == 1 and {p['verdict'] for p in told} == {'measured'}
    assert abs(told[0]['speed_mps'] - told[1]['speed_mps']) < told[0]['speed_std_mps']


def test_unreadable_site_makes_configuring_fail(stand_in, sample, tmp_path):
    """The site can be corrected without a restart."""
    site = tmp_path / 'site.yaml'
    with Process('tracker_node', f'site:={site}', 'autostart:=false') as node:
        manager = Manager(stand_in, 'tracker_node')
        assert manager.change(CONFIGURE) == (False, UNCONFIGURED)
        assert not node.ended()
        site.write_text((sample / 'site.yaml').read_text())
        assert manager.change(CONFIGURE) == (True, INACTIVE)
        assert manager.change(ACTIVATE) == (True, ACTIVE)


def test_unmanaged_node_activates_itself(stand_in, sample):
    with Process('tracker_node', f'site:={sample / "site.yaml"}'):
        stand_in.wait(lambda: stand_in.count_subscribers('/stereo/image_pair') == 1, STARTUP_S)
        assert Manager(stand_in, 'tracker_node').state == ACTIVE
