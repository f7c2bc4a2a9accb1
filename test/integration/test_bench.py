# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The live benchmark and its peers, with the sample in place of traffic, over real DDS."""
from __future__ import annotations

import pytest

pytest.importorskip('rclpy')

from stereo_speed.lab.cli.bench_live import _timed  # noqa: E402, I100
from stereo_speed.lab.cli.live_graph import Traffic  # noqa: E402
from stereo_speed.nodes.delay_listener import AnswerListener  # noqa: E402


def test_peer_that_matches_each_pair_is_timed(private_graph, sample):
    """Of 12 pairs, 0.2 s apart, a newer one may arrive while one is matched."""
    traffic = Traffic.of(sample, 5.0)
    listener, cpu_ms = _timed(traffic, ('pairing_peer_node', 'matching:=sgbm'), ('/answers',),
                              AnswerListener)
    assert 2 <= len(listener.pairs_ns) <= 12
    assert listener.pairs_ns == sorted(set(listener.pairs_ns) & set(traffic.stamps_ns))
    # Each is answered after it was sent. To match 1024x768 takes tens of ms of a processor; to
    # pair and to answer takes two.
    assert len(listener.delays_s) == len(listener.pairs_ns) and min(listener.delays_s) > 0.005
    assert 10 < cpu_ms < 5000
