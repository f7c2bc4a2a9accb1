# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Keeps a restarted node off the shared-memory ports that killed processes have left.

A participant of Fast DDS takes the first UDP ports that are free, and its port of shared memory
has the same number.  If a process was killed, others keep its port of shared memory mapped until
their watchdog finds it dead, with Fast DDS 2.14 up to two seconds later.  Until then they write to
it what they send to the process that has got its number, which therefore receives nothing.  So a
node takes other ports.
"""
from __future__ import annotations

from contextlib import contextmanager, ExitStack
import fcntl
from pathlib import Path
import re
import socket
from typing import Iterable, Iterator

_MEMORY = Path('/dev/shm')  # noqa: S108, of all processes, not a file of ours
_LOCK = re.compile(r'fast(?:rtps|dds)_port(\d+)_el')  # held while the port's owner lives
# RTPS 2.5, section 9.6.2.3: ports for discovery of a domain's participants, each followed by one
# for data
_FIRST, _PER_DOMAIN, _PER_PARTICIPANT = 7410, 250, 2
# Participants on one machine look for each other at the first ports only; so some remain.
_MOST = 8


def abandoned(domain: int, memory: Path = _MEMORY) -> list[int]:
    """
    Return the least ports of participants of a domain that have left a port of shared memory.

    The newest come first; most files of older ones remain, long after others have let go of them.

    :param domain: DDS domain.
    :param memory: folder of the shared memory; where it is missing or cannot be listed, nothing
        is known to be abandoned.
    """
    first = _FIRST + _PER_DOMAIN * domain
    begun_ns: dict[int, int] = {}
    try:
        paths = list(memory.iterdir())
    except OSError:
        return []
    for path in paths:
        named = _LOCK.fullmatch(path.name)
        port = int(named[1]) if named else 0
        if first <= port < first + _PER_DOMAIN - 10 and not _is_locked(path):
            port -= (port - first) % _PER_PARTICIPANT
            begun_ns[port] = max(begun_ns.get(port, 0), _begun_ns(path))
    return sorted(begun_ns, key=lambda port: -begun_ns[port])


@contextmanager
def others_than(ports: Iterable[int]) -> Iterator[None]:
    """
    Keep ports taken, so that a participant made meanwhile takes others.

    :param ports: as of :func:`abandoned`, of which the first eight count; those that are in use
        already are left alone.
    """
    with ExitStack() as held:
        for port in list(ports)[:_MOST]:
            for number in range(port, port + _PER_PARTICIPANT):
                taken = held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                try:
                    taken.bind(('', number))
                except OSError:  # another process has it
                    taken.close()
        yield


def _begun_ns(path: Path) -> int:
    """Return when a participant made a file, ns since the epoch; 0 where it is gone by now."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _is_locked(path: Path) -> bool:
    """Return whether a process holds a lock file; of one that cannot be read it is assumed."""
    try:
        with path.open() as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # Fast DDS asks in the same way
            return False
    except OSError:
        return True
