# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A restarted node takes other ports than those that killed processes have left."""
from __future__ import annotations

import fcntl
import os
from pathlib import Path
import socket
import subprocess
import sys
from threading import Timer

import pytest

pytest.importorskip('rclpy')

from stereo_speed.nodes.ports import abandoned, others_than  # noqa: E402

OF_DOMAIN_3 = 7410 + 3 * 250


def port_of(memory, number, prefix='fastrtps', begun_s=0):
    """Return the lock file of a port of shared memory."""
    path = memory / f'{prefix}_port{number}_el'
    path.touch()
    os.utime(path, (begun_s, begun_s))
    return path


def test_abandoned_ports_are_those_of_the_domain_that_no_process_holds(tmp_path):
    port_of(tmp_path, OF_DOMAIN_3 + 5, begun_s=1)  # for data of the third participant
    port_of(tmp_path, OF_DOMAIN_3 + 2, 'fastdds', begun_s=2)
    port_of(tmp_path, OF_DOMAIN_3 - 250)  # of another domain
    port_of(tmp_path, OF_DOMAIN_3 + 250)
    (tmp_path / f'sem.fastrtps_port{OF_DOMAIN_3}_mutex').touch()
    with port_of(tmp_path, OF_DOMAIN_3 + 1, begun_s=3).open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert abandoned(3, tmp_path) == [OF_DOMAIN_3 + 2, OF_DOMAIN_3 + 4]
    assert abandoned(3, tmp_path) == [OF_DOMAIN_3, OF_DOMAIN_3 + 2, OF_DOMAIN_3 + 4]


def test_nothing_is_abandoned_where_there_is_no_shared_memory(tmp_path):
    assert abandoned(3, tmp_path / 'missing') == []


def test_nothing_is_abandoned_where_the_shared_memory_cannot_be_listed(tmp_path, monkeypatch):
    def refuse(folder):
        raise PermissionError(13, 'Permission denied', str(folder))
    monkeypatch.setattr(Path, 'iterdir', refuse)
    assert abandoned(3, tmp_path) == []


def test_ports_of_the_process_that_was_killed_last_come_first(tmp_path):
    """Files of older ones remain, so the newest would be the one that is not skipped."""
    for k, begun_s in enumerate([5, 2, 9, 1]):
        port_of(tmp_path, OF_DOMAIN_3 + 2 * k, begun_s=begun_s)
    port_of(tmp_path, OF_DOMAIN_3 + 3, begun_s=7)  # for data of the second
    assert abandoned(3, tmp_path) == [OF_DOMAIN_3 + 2 * k for k in (2, 1, 0, 3)]


def is_free(port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        try:
            taken.bind(('', port))
        except OSError:
            return False
        return True


def test_ports_are_taken_for_the_block_only():
    first = next(p for p in range(20000, 30000, 2) if is_free(p) and is_free(p + 1))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as used:
        used.bind(('', first))  # by another process; the second is taken nevertheless
        with others_than([first]):
            assert not is_free(first + 1)
    assert is_free(first) and is_free(first + 1)


def test_few_participants_are_skipped_however_many_have_left_ports():
    start = next(p for p in range(20000, 30000, 40) if all(map(is_free, range(p, p + 40))))
    with others_than(range(start, start + 40, 2)):
        assert sum(map(is_free, range(start, start + 40))) == 40 - 2 * 8


NODE = """
from pathlib import Path
import os
import sys
import rclpy
from rclpy.node import Node
from stereo_speed.nodes.common import run

def ports(node):
    mine = {os.readlink(fd) for fd in Path('/proc/self/fd').iterdir() if fd.is_symlink()}
    rows = [line.split() for line in Path('/proc/self/net/udp').read_text().splitlines()[1:]]
    print(rclpy.get_rmw_implementation_identifier(), rclpy.get_default_context().get_domain_id(),
          *(int(row[1].split(':')[1], 16) for row in rows if f'socket:[{row[9]}]' in mine))
    sys.stdout.flush()
    sys.stdin.read()

run(lambda: Node('node'), [], ports)
"""


@pytest.fixture
def node_process(private_graph):
    """Return a starter of processes with a node; each with what it told of itself."""
    started = []

    def start():
        process = subprocess.Popen([sys.executable, '-c', NODE], stdin=subprocess.PIPE,
                                   stdout=subprocess.PIPE, text=True)
        started.append(process)
        bound = Timer(60.0, process.kill)
        bound.start()
        rmw, domain, *ports = process.stdout.readline().split()
        bound.cancel()
        return process, rmw, int(domain), set(map(int, ports))
    yield start
    for process in started:
        process.kill()
        process.communicate(timeout=30)


@pytest.mark.slow
def test_node_takes_other_ports_than_a_killed_one(node_process):
    killed, rmw, domain, before = node_process()
    if rmw != 'rmw_fastrtps_cpp':
        pytest.skip(f'ports of shared memory of {rmw}')
    killed.kill()
    killed.wait(timeout=30)
    left = before & set(abandoned(domain))
    assert left
    *_, after = node_process()
    assert after and not after & left
