# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Play simulated traffic to nodes: separate processes over DDS, in real time."""
from __future__ import annotations

from contextlib import AbstractContextManager, contextmanager, ExitStack
from dataclasses import dataclass, replace
import os
from pathlib import Path
import subprocess
import sys
from typing import Iterator, Mapping, Sequence, TYPE_CHECKING

from ..evaluation.traffic_run import stream_of
from ..sim.config import RigConfig, RIGS
from ..sim.traffic_config import traffic_config
from ..sim.write import write_traffic_bag
from ...cli.demo import Process, RELIABLE_IMAGES, RELIABLE_INFOS
from ...core.errors import StereoSpeedError
from ...io.bags import StereoBag
from ...io.topics import SIDES

if TYPE_CHECKING:
    from ...nodes.delay_listener import AnswerListener
    from ...nodes.soak_listener import SoakListener

START_S = 180.0  # the first start compiles the kernels
ON_ITS_WAY_S = 1.0  # longest delivery time of the last messages
ONE_NODE = ('speed_camera_node', *RELIABLE_IMAGES, *RELIABLE_INFOS)
TOLD = ('/vehicle_speed', '/tracks', '/track_states', '/passes')  # topics of measuring nodes


# A busy loop that ends with its parent, however that ends.
_BURN = 'import os\nwhile os.getppid() == {parent}: sum(range(100_000))'


class GraphError(StereoSpeedError):
    """A node ended, or the nodes did not connect."""


class Burner(AbstractContextManager['Burner']):
    """A process that keeps a core busy; a context manager that ends the process on exit."""

    def __init__(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, '-c', _BURN.format(parent=os.getpid())], stdin=subprocess.DEVNULL)

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()


@contextmanager
def confined(one_core: bool = True) -> Iterator[None]:
    """Confine processes that are started meanwhile to one core, the same one each time."""
    cores = os.sched_getaffinity(0)
    if one_core:
        os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


@dataclass(frozen=True, kw_only=True)
class Traffic:
    """
    Recorded traffic to be played.

    :param folder: folder with ``bag``, ``site.yaml`` and ``truth.csv``.
    :param stamps_ns: stamps of its pairs.
    :param fps: pairs per second.
    """

    folder: Path
    stamps_ns: Sequence[int]
    fps: float

    @classmethod
    def of(cls, folder: Path, fps: float) -> Traffic:
        """Return the traffic in a folder; stamps of both views have to be equal."""
        with StereoBag(folder / 'bag') as bag:  # only stamps, because decoding images is slow
            both = {side: {m.stamp_ns for m in bag.messages()
                           if (m.side, m.kind) == (side, 'image')} for side in SIDES}
        return cls(folder=folder, stamps_ns=sorted(set.intersection(*both.values())), fps=fps)

    @classmethod
    def drawn(cls, folder: Path, seed: int, *, lanes: int, fps: float, minutes: float,
              vehicles: int, width_px: int) -> Traffic:
        """Simulate traffic, with the usual rig at another image size, and write it to a folder."""
        write_traffic_bag(stream_of(traffic_config(
            lanes=lanes, fps=fps, minutes=minutes, vehicles=vehicles, rig=rig_of(width_px)),
            seed), folder, compressed=True)
        return cls.of(folder, fps)

    @property
    def round_ns(self) -> int:
        """Return the time from a stamp to the same one of the next round, ns."""
        # one more interval, so that rounds follow each other like pairs
        return self.stamps_ns[-1] - self.stamps_ns[0] + round(1e9 / self.fps)

    @property
    def site(self) -> str:
        """Return the parameter with the site for nodes."""
        return f'site:={self.folder / "site.yaml"}'


def rig_of(width_px: int) -> RigConfig:
    """Return a rig with the usual field of view and another image size."""
    usual = RIGS['parallel']
    return replace(usual, width_px=width_px, height_px=width_px * 3 // 4,
                   f_px=usual.f_px * width_px / usual.width_px)


def started(stack: ExitStack, commands: Sequence[Sequence[str]]) -> dict[str, Process]:
    """Start nodes, which end with the stack, and return them by name."""
    return {command[0]: stack.enter_context(Process(*command)) for command in commands}


def play(stack: ExitStack, traffic: Traffic, nodes: Mapping[str, Process],
         listener: SoakListener | AnswerListener, told: Sequence[str], *, rounds: int = 1,
         wait_for: str = '') -> Process:
    """
    Play traffic to nodes when all are connected; return the player after the first pair.

    :param told: topics of the listener.
    :param rounds: number of rounds.
    :param wait_for: topics between the nodes that have to be connected.
    :raises GraphError: a node has ended, or they do not discover each other.
    """
    if not listener.spin(START_S, lambda: alive(nodes) and listener.connected(*told)):
        raise GraphError(f'live: graph: found nodes not connected after {START_S:.0f} s, '
                         'wanted all connected')
    replay = stack.enter_context(Process(
        'repeating_replay_node', f'bag:={traffic.folder / "bag"}', f'rounds:={rounds}',
        f'round_s:={traffic.round_ns * 1e-9}',
        *([f'wait_for_topics:={wait_for}'] if wait_for else [])))
    listener.spin(START_S, lambda: alive(nodes) and (
        bool(listener.pairs_ns) or replay.ended()))
    listener.spin(ON_ITS_WAY_S, lambda: alive(nodes) and bool(listener.pairs_ns))
    if not listener.pairs_ns:
        raise GraphError('live: pairs: found no result, ' + (
            f'as the replay ended with status {replay.process.returncode}'
            if replay.ended() else f'within {START_S:.0f} s') + ', wanted one of each pair')
    return replay


def alive(nodes: Mapping[str, Process]) -> bool:
    """
    Return True if all nodes are running.

    :raises GraphError: one of the nodes has ended.
    """
    for node in nodes.values():
        if node.ended():
            raise GraphError(f'live: {node.name}: found it ended with status '
                             f'{node.process.returncode}, wanted it running')
    return True


def processor_s(pid: int) -> float:
    """
    Return the processor time of a process and its running children, s.

    :raises OSError: there is no such process.
    """
    ticks: dict[int, tuple[int, int]] = {}  # parent and ticks of each process
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            fields = (folder / 'stat').read_text().rpartition(')')[2].split()
        except OSError:  # the process has ended
            continue
        ticks[int(folder.name)] = int(fields[1]), int(fields[11]) + int(fields[12])
    if pid not in ticks:
        raise ProcessLookupError(pid)
    family, found = {pid}, 0
    while len(family) > found:
        found = len(family)
        family |= {child for child, (parent, _) in ticks.items() if parent in family}
    return sum(ticks[one][1] for one in family) / os.sysconf('SC_CLK_TCK')
