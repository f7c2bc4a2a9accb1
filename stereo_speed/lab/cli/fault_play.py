# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""One trial of ``faults``: nodes run, a bag with a fault is played to them, all is heard."""
from __future__ import annotations

from contextlib import contextmanager, ExitStack
import os
from pathlib import Path
import signal
import time
from typing import Callable, Iterator, Mapping, NamedTuple, Sequence, TYPE_CHECKING

import numpy as np

from .fault_rows import is_back, Row, row_of, Times
from .fault_trials import Trial
from .fault_truth import Truth
from ...cli.demo import Process
from ...core.errors import InputError
from ...io.truth import VehicleTruth

if TYPE_CHECKING:
    from ...nodes.fault_listener import FaultListener, Heard

_START_S, _AFTER_S = 180.0, 4.0  # the first start compiles the kernels
_APART_PERIOD_S = 0.2  # period of cameras that expose at different times
_RESPAWN_S = 0.2  # as in the launch file
_APPROXIMATE = ('approximate_sync:=true', 'approximate_sync_tolerance_seconds:=0.06')
_PROFILE = 'FASTRTPS_DEFAULT_PROFILES_FILE'


class Recorded(NamedTuple):
    """
    The traffic that is played.

    :param folder: the folder with its bag and its site.
    :param truth: the vehicles in it.
    :param first_ns: first stamp of the bag.
    """

    folder: Path
    truth: Sequence[VehicleTruth]
    first_ns: int


class Playing(NamedTuple):
    """
    How a trial is played.

    :param name: name of the trial.
    :param trial: its fault.
    :param single: whether one node measures instead of three.
    :param rate: speed of the replay.
    :param first_s: start of the fault, s of the bag.
    :param length_s: duration of the fault, s of the bag.
    :param play_s: how much of the bag is played, s.
    """

    name: str
    trial: Trial
    single: bool
    rate: float
    first_s: float
    length_s: float
    play_s: float

    @property
    def measuring(self) -> str:
        """Return the name of the node that measures."""
        return 'speed_camera_node' if self.single else 'tracker_node'

    def commands(self, site: Path) -> Mapping[str, Sequence[str]]:
        """Return the arguments of each node, by its name."""
        pairing = (*self.trial.pairing, *(_APPROXIMATE if self.trial.approximate else ()))
        place = f'site:={site}'
        return {'speed_camera_node': (place, *pairing)} if self.single else {
            'stereo_sync_node': pairing, 'tracker_node': (place,), 'speed_node': ()}

    def camera(self, recorded: Recorded) -> tuple[str, ...]:
        """Return the arguments of the node that plays the bag."""
        stream = self.name if self.trial.stream is None else self.trial.stream
        chain = () if self.single else ('wait_for_topics:=stereo/image_pair tracks',)
        return (f'bag:={recorded.folder / "bag"}', f'rate:={self.rate}', *chain,
                *self.trial.sending, f'fault:={stream}', f'fault_start:={self.first_s}',
                f'fault_length:={self.length_s}', f'length:={self.play_s}',
                f'exposures:={_exposures(recorded.truth)}')


def play(how: Playing, recorded: Recorded) -> Row:
    """
    Play a bag with one fault, and judge what is heard.

    :param how: the fault.
    :param recorded: the traffic.
    :raises InputError: nodes that do not start, or a helper process that is not there.
    """
    from ...nodes.fault_listener import FaultListener
    with _Graph(how.commands(recorded.folder / 'site.yaml')) as graph:
        with profile_of('nodes', how.trial):
            graph.start()
        listener = FaultListener()
        graph.callback(listener.close)
        heard = listener.heard
        _wait_for(listener, 'graph', lambda: listener.connected(
            '/vehicle_speed', '/passes', '/tracks', '/diagnostics') and _measures(heard))
        with profile_of('camera', how.trial):
            camera = graph.enter_context(Process('faulty_replay_node', *how.camera(recorded)))
        _wait_for(listener, how.name, lambda: bool(heard.begun_s))
        # On a busy machine the first messages of the replay may be missed here.
        begun_s = heard.begun_s - (heard.begun_ns - recorded.first_ns) * 1e-9 / how.rate
        ended_s = _fault_ended(how, graph, listener, camera, begun_s)
        _listen_until(listener, camera, begun_s + how.play_s / how.rate)
        back = is_back(heard)
        listener.spin(_AFTER_S, lambda: False)
        alive = graph.is_alive()
    return row_of(how.name, heard, Truth(recorded.truth, how.trial.shifts_s),
                  Times(begun_s, begun_s + how.first_s / how.rate, ended_s,
                        recorded.first_ns + round((ended_s - begun_s) * how.rate * 1e9),
                        how.play_s / how.rate), alive, back)


class _Graph(ExitStack):
    """
    The nodes of a trial, each in a process that ends with it.

    :param commands: the arguments of each node, by its name.
    """

    def __init__(self, commands: Mapping[str, Sequence[str]]) -> None:
        super().__init__()
        self._commands = commands
        self._nodes: dict[str, Process] = {}

    def start(self, *names: str) -> None:
        """Start some nodes, all unless they are named; of a name the newest process counts."""
        for name in names or self._commands:
            self._nodes[name] = self.enter_context(Process(name, *self._commands[name]))

    def kill(self, name: str) -> None:
        """Kill a node."""
        self._nodes[name].process.kill()

    def kill_helper(self, name: str, module: str) -> None:
        """Kill the process that a node has started for a module."""
        os.kill(helper_of(self._nodes[name].process.pid, module), signal.SIGKILL)

    def is_alive(self) -> bool:
        """Return whether no node has ended."""
        return not any(node.ended() for node in self._nodes.values())


def _fault_ended(how: Playing, graph: _Graph, listener: FaultListener, camera: Process,
                 begun_s: float) -> float:
    """
    Return the steady time of the end of the fault, s; a process that is to die is killed.

    :param begun_s: steady time of the start of the stream, s.
    """
    trial = how.trial
    if not (trial.kill or trial.kill_helper):
        return begun_s + (0.0 if trial.always else (how.first_s + how.length_s) / how.rate)
    _listen_until(listener, camera, begun_s + how.first_s / how.rate)
    if trial.kill:
        graph.kill(trial.kill)
        listener.spin(_RESPAWN_S, lambda: False)
        graph.start(trial.kill)
    else:
        graph.kill_helper(how.measuring, trial.kill_helper)
    return time.monotonic()


def _wait_for(listener: FaultListener, what: str, is_there: Callable[[], bool]) -> None:
    if not listener.spin(_START_S, is_there):
        raise InputError('faults', what, f'not ready after {_START_S:.0f} s',
                         'nodes that are connected and measure, and a replay')


def _listen_until(listener: FaultListener, camera: Process, steady_s: float) -> None:
    """Hear all messages until a steady time, or until the bag has been played."""
    listener.spin(max(steady_s - time.monotonic(), 0.0), camera.ended)


@contextmanager
def profile_of(role: str, trial: Trial) -> Iterator[None]:
    """
    Give processes that are started here the DDS profile for large images, or not.

    :param role: their role in the graph: camera, nodes.
    :param trial: the trial that is played.
    """
    profile = os.environ.pop(_PROFILE, None) if role in trial.no_profile else None
    try:
        yield
    finally:
        if profile is not None:
            os.environ[_PROFILE] = profile


def helper_of(pid: int, module: str) -> int:
    """
    Return the id of the helper process that a node has started for a module.

    :raises InputError: there is no such process.
    """
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            parent = int((folder / 'stat').read_text().rpartition(')')[2].split()[1])
            command = (folder / 'cmdline').read_text() + (folder / 'comm').read_text()
        except OSError:  # the process has ended
            continue
        if parent == pid and module in command:
            return int(folder.name)
    raise InputError('faults', f'process {pid}', f'no child process that runs {module}', 'one')


def _exposures(truth: Sequence[VehicleTruth]) -> int:
    """Return the number of exposures of the bag between two images of a camera."""
    stamps_ns = np.unique(np.concatenate([vehicle.stamps_ns for vehicle in truth]))
    return max(round(_APART_PERIOD_S / (float(np.diff(stamps_ns).min()) * 1e-9)), 2)


def _measures(heard: Heard) -> bool:
    """Return whether the measuring node reports that it is ready to measure."""
    said = [message for _, name, _, message in heard.levels if name.endswith(': pipeline')]
    return bool(said) and not said[-1].startswith(('not configured', 'inactive'))
