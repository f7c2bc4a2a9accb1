# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The live benchmark where nodes cannot be timed, and the processes whose time counts."""
from __future__ import annotations

from contextlib import contextmanager, ExitStack, nullcontext
from pathlib import Path
import subprocess
import sys
from types import SimpleNamespace

import pytest
from stereo_speed.lab.cli import bench_live, live_graph
from stereo_speed.lab.cli.bench_live import live_lines, live_table
from stereo_speed.lab.cli.live_graph import alive, GraphError, play, processor_s, Traffic


@pytest.fixture
def undrawn(monkeypatch):
    """Replace the simulation of traffic, and leave the graph of this process unchanged."""
    monkeypatch.setattr(bench_live, 'private_graph', lambda: None)
    monkeypatch.setattr(bench_live, 'Traffic', SimpleNamespace(drawn=lambda *_, **__: None))


def test_missing_ros_is_one_line(undrawn, monkeypatch):
    for name in [name for name in sys.modules if name.startswith('stereo_speed.nodes.')]:
        monkeypatch.delitem(sys.modules, name)
    for name in ('rclpy', 'rosgraph_msgs'):
        monkeypatch.setitem(sys.modules, name, None)
    assert live_lines(1.0) in {f'live over DDS: not measured, {name} is not installed\n'
                               for name in ('rclpy', 'rclpy.executors', 'rosgraph_msgs.msg',
                                            'rosgraph_msgs')}


def test_failing_graph_is_one_line(undrawn, monkeypatch):
    def fails(traffic):
        raise GraphError('live: one: found it\nended')
    monkeypatch.setattr(bench_live, 'live_table', fails)
    assert live_lines(1.0) == 'live over DDS: not measured, live: one: found it ended\n'


def test_delays_and_pairs_are_reported_for_each_node(undrawn, monkeypatch):
    """Of 4 pairs at 10 pairs/s, all four or half of them were accepted."""
    pytest.importorskip('rclpy')
    delays_s = [0.010, 0.020, 0.030, 0.110]

    def timed(traffic, command, told, listen, wait_for=''):
        some = delays_s if 'matching:=sgbm' not in command else delays_s[2:]
        return SimpleNamespace(pairs_ns=range(len(some)), delays_s=some,
                               reading_delays_s=[0.005]), 7.0
    monkeypatch.setattr(bench_live, '_timed', timed)
    traffic = Traffic(folder=Path('here'), stamps_ns=range(4), fps=10.0)
    rows = [line.strip('| ').split(' | ')
            for line in live_table(traffic).markdown().splitlines()[4:]]
    assert [row[2:] for row in rows] == [
        ['10.0', '5.0', '5.0', '7.0'], ['10.0', '25.0', '98.0', '7.0'],
        ['5.0', '70.0', '106.0', '7.0'], ['10.0', '25.0', '98.0', '7.0']]
    assert rows[0][1] == '1 readings, 0 passes'


def test_rounds_follow_each_other_at_the_pair_interval(sample):
    """The sample has 12 pairs, 0.2 s apart."""
    traffic = Traffic.of(sample, 5.0)
    assert len(traffic.stamps_ns) == 12
    assert traffic.round_ns == pytest.approx(12 * 0.2e9, abs=1e6)


@contextmanager
def python(code):
    """Run Python code in a process that is killed in the end."""
    with subprocess.Popen([sys.executable, '-c', code], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.kill()


def test_cpu_time_includes_that_of_child_processes():
    """A parent that sleeps while its child works for 0.4 s uses no time itself."""
    work = ('import time\nwhile time.process_time() < 0.4: pass\n'
            'print("done", flush=True)\ntime.sleep(60)')
    code = ('import os, subprocess, sys\n'
            f'one = subprocess.Popen([sys.executable, "-c", {work!r}], stdout=subprocess.PIPE)\n'
            'print(one.stdout.readline(), one.pid, flush=True)\nsys.stdin.read()')
    with python(code) as process:
        helper = int(process.stdout.readline().split()[-1])
        both_s, its_s = processor_s(process.pid), processor_s(helper)
        subprocess.run(['kill', str(helper)], check=True)
    assert its_s >= 0.39 and its_s < both_s < its_s + 5.0
    with pytest.raises(ProcessLookupError):
        processor_s(process.pid)


def test_ended_node_is_reported():
    class Ended:
        name, process = 'one_node', SimpleNamespace(returncode=2)

        @staticmethod
        def ended():
            return True
    with pytest.raises(GraphError, match='one_node: found it ended with status 2'):
        alive({'one_node': Ended})


@pytest.mark.parametrize('status', [0, 1])
def test_replay_that_ends_before_any_result_is_not_waited_for(status, monkeypatch):
    """Whatever its exit status: 0 means that all was played."""
    monkeypatch.setattr(live_graph, 'Process', lambda *_: nullcontext(SimpleNamespace(
        process=SimpleNamespace(poll=lambda: status, returncode=status), ended=lambda: True)))
    waited_s = []

    def spin(seconds, until):
        met = bool(until())
        waited_s.append(0.0 if met else seconds)
        return met
    listener = SimpleNamespace(pairs_ns=[], connected=lambda *_: True, spin=spin)
    traffic = Traffic(folder=Path('here'), stamps_ns=range(4), fps=10.0)
    with ExitStack() as stack, pytest.raises(GraphError, match=f'ended with status {status}'):
        play(stack, traffic, {}, listener, ())
    assert sum(waited_s) < 5.0


def test_node_without_a_process_is_one_line(undrawn, monkeypatch):
    with python('') as process:
        process.wait()
    node = SimpleNamespace(name='one_node', process=process)
    monkeypatch.setattr(bench_live, 'live_table', lambda _: bench_live._taken_s(node))
    assert live_lines(1.0) == ('live over DDS: not measured, live: one_node: found its process '
                               'gone, wanted it running\n')
