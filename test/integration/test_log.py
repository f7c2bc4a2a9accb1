# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``log_node`` over real DDS, killed directly after logging, and stopped with other nodes."""
from __future__ import annotations

import signal
import sqlite3
import subprocess

import pytest

pytest.importorskip('rclpy')

from nav_msgs.msg import Odometry  # noqa: E402, I100
from rclpy.duration import Duration  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from stereo_speed.cli.demo import Process  # noqa: E402
from stereo_speed.core.passes import PassResult, Verdict  # noqa: E402
from stereo_speed.io.pass_json import pass_text  # noqa: E402

STARTUP_S, EVENT_S = 60.0, 20.0


def test_published_messages_are_in_the_file_even_after_a_kill(stand_in, tmp_path):
    from stereo_speed.nodes.common import LATCHED, RELIABLE
    path = tmp_path / 'passes.sqlite'
    passes = stand_in.create_publisher(String, '/passes', LATCHED)
    tracks = stand_in.create_publisher(Odometry, '/tracks', RELIABLE)
    texts = [pass_text('run', PassResult(k, 'near', 10, 20, 5, 24.5, 0.1, Verdict.MEASURED, '',
                                         {}, {})) for k in range(3)]
    track = Odometry(child_frame_id='vehicle_0')
    track.header.stamp.sec, track.header.stamp.nanosec = 7, 5
    track.twist.twist.linear.x, track.twist.covariance[0] = 24.5, 0.04
    track.pose.pose.position.z = 30.0

    def count(table):
        database = sqlite3.connect(f'file:{path}?mode=ro', uri=True)
        try:
            return database.execute(f'SELECT count(*) FROM {table}').fetchone()[0]
        except sqlite3.OperationalError:
            return 0
        finally:
            database.close()

    with Process('log_node', f'file:={path}', 'sync_s:=0.1') as node:
        stand_in.wait(lambda: stand_in.count_subscribers('/passes')
                      and stand_in.count_subscribers('/tracks'), STARTUP_S)
        tracks.publish(track)
        for text in (*texts, texts[0], 'no pass'):
            passes.publish(String(data=text))
        stand_in.wait(lambda: path.exists() and count('passes') == 3 and count('tracks') == 1,
                      EVENT_S)
        node.process.kill()
        node.process.wait(10)
    database = sqlite3.connect(path)
    assert [row[0] for row in database.execute('SELECT json FROM passes')] == texts
    assert database.execute('SELECT * FROM tracks').fetchall() == [
        (7_000_000_005, 'vehicle_0', 24.5, 0.2, 0.0, 0.0, 30.0)]
    assert database.execute('PRAGMA integrity_check').fetchall() == [('ok',)]
    database.close()


def test_passes_that_are_published_while_all_nodes_end_are_in_the_file(stand_in, tmp_path):
    """A measuring node publishes its open passes when it is told to stop, as this node is."""
    from stereo_speed.nodes.common import LATCHED
    path = tmp_path / 'passes.sqlite'
    passes = stand_in.create_publisher(String, '/passes', LATCHED)
    texts = [pass_text('run', PassResult(k, 'near', 10, 20, 5, 24.5, 0.1, Verdict.MEASURED, '',
                                         {}, {})) for k in range(2)]
    with Process('log_node', f'file:={path}') as node:
        passes.publish(String(data=texts[0]))
        stand_in.wait(lambda: passes.get_subscription_count() == 1, STARTUP_S)
        assert passes.wait_for_all_acked(Duration(seconds=EVENT_S))  # it knows this process
        node.process.send_signal(signal.SIGINT)
        with pytest.raises(subprocess.TimeoutExpired):  # it waits for this process
            node.process.wait(1.0)
        passes.publish(String(data=texts[1]))
        assert passes.wait_for_all_acked(Duration(seconds=EVENT_S))
        stand_in.destroy_publisher(passes)
        assert node.process.wait(EVENT_S) == 0
    database = sqlite3.connect(path)
    assert [row[0] for row in database.execute('SELECT json FROM passes')] == texts
    database.close()
