# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A disk fault is reported until a write succeeds again, and passes wait until it does."""
from __future__ import annotations

import sqlite3

import pytest

pytest.importorskip('rclpy')

from nav_msgs.msg import Odometry  # noqa: E402, I100
from std_msgs.msg import String  # noqa: E402
from stereo_speed.core.passes import PassResult, Verdict  # noqa: E402
from stereo_speed.io.pass_json import pass_text  # noqa: E402
from stereo_speed.nodes.health import ERROR, OK  # noqa: E402
from stereo_speed.nodes.log_node import LogNode  # noqa: E402


def test_fault_ends_when_readings_are_written_again(in_process, tmp_path):
    with in_process(LogNode, f'file:={tmp_path / "passes.sqlite"}') as node:
        node.failed(sqlite3.OperationalError('database or disk is full'))
        node.sync()  # without anything to write, so the disk's state is unknown
        assert node.state().level == ERROR
        node.on_track(Odometry(child_frame_id='vehicle_0'))
        assert node.state().level == ERROR
        node.sync()
        assert node.state().level == OK


def test_passes_wait_for_a_disk_that_can_be_written(in_process, tmp_path, monkeypatch):
    path = tmp_path / 'passes.sqlite'
    texts = [pass_text('run', PassResult(k, 'near', 10, 20, 5, 24.5, 0.1, Verdict.MEASURED, '',
                                         {}, {})) for k in range(3)]

    def full(text):
        raise sqlite3.OperationalError('database or disk is full')
    with in_process(LogNode, f'file:={path}') as node:
        with monkeypatch.context() as patch:
            patch.setattr(node.log, 'add_pass', full)
            node.on_pass(String(data=texts[0]))
            node.on_pass(String(data='no pass'))
            node.on_track(Odometry(child_frame_id='vehicle_0'))
            node.sync()  # the reading can be written, the passes still cannot
            assert node.state().level == ERROR
            assert node.state().values['unwritten'] == 2
        node.on_pass(String(data=texts[1]))
        assert node.state().level == OK
        assert (node.passes, node.refused, node.state().values['unwritten']) == (2, 1, 0)
        with monkeypatch.context() as patch:
            patch.setattr(node.log, 'add_pass', full)
            node.on_pass(String(data=texts[2]))
    database = sqlite3.connect(path)  # closing has written the last one
    assert [row[0] for row in database.execute('SELECT json FROM passes')] == texts
    database.close()


def test_node_ends_although_the_disk_cannot_be_written(in_process, tmp_path, monkeypatch, capfd):
    with in_process(LogNode, f'file:={tmp_path / "passes.sqlite"}') as node:
        def fail():
            raise sqlite3.OperationalError('disk I/O error')
        monkeypatch.setattr(node.log, 'keep', fail)
        monkeypatch.setattr(node.log, 'close', fail)
    assert '0 passes are not written' in capfd.readouterr().err
