# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Start and end of nodes, in this process."""
from __future__ import annotations

import os
import signal

import pytest

pytest.importorskip('rclpy')

from stereo_speed.nodes import common  # noqa: E402, I100
from stereo_speed.nodes.log_node import LogNode, main  # noqa: E402


@pytest.fixture(autouse=True)
def handlers():
    """Restore the signal handlers that a node replaces."""
    former = {one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)}
    yield
    for one, handler in former.items():
        signal.signal(one, handler)


def test_help_of_a_node_is_printed_and_writes_no_file(
        private_graph, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(['--help']) == 0
    assert 'sync_s [1.0] (0.05 to 3600)' in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == [] and os.getcwd() == str(tmp_path)


@pytest.mark.parametrize('one', [signal.SIGINT, signal.SIGTERM])
def test_interrupt_raised_as_an_error_by_rclpy_ends_a_node(private_graph, tmp_path, one):
    def spin(node):
        try:
            os.kill(os.getpid(), one)
        except KeyboardInterrupt:
            raise RuntimeError('Unable to convert call argument') from None

    def broken(node):
        raise RuntimeError('a fault of ours')
    given = ['--ros-args', '-p', f'file:={tmp_path / "passes.sqlite"}']
    assert common.run(LogNode, given, spin) == 0
    with pytest.raises(RuntimeError, match='a fault of ours'):
        common.run(LogNode, given, broken)


@pytest.mark.parametrize('again', [signal.SIGINT, signal.SIGTERM])
def test_node_stopped_twice_completes_its_shutdown(private_graph, tmp_path, again):
    """As by Ctrl-C under ``ros2 launch``: the terminal signals both, and launch forwards it."""
    ended = []

    class Listening(LogNode):

        def close(self):
            os.kill(os.getpid(), again)
            super().close()
            ended.append('closed')

        def destroy_node(self):
            os.kill(os.getpid(), again)
            super().destroy_node()
            ended.append('destroyed')
    given = ['--ros-args', '-p', f'file:={tmp_path / "passes.sqlite"}']
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    assert common.run(Listening, given, lambda node: os.kill(os.getpid(), signal.SIGINT)) == 0
    assert ended == ['closed', 'destroyed']
    # A process started afterwards can be ended.
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == handlers
