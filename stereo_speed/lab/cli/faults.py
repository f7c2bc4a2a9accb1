# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``faults``: break a stream in many ways while the live nodes measure it.

The nodes run as separate processes over DDS, as in ``demo``. A bag of simulated traffic is played
to them with one fault after the other, and all their output is compared with the truth. A reading
or a pass is wrong if its error exceeds 1 mph and 4 sigma.
"""
from __future__ import annotations

import argparse
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
import os
from pathlib import Path
import signal
import sys
import time
from typing import Optional, Sequence, TYPE_CHECKING

import numpy as np

from ...cli.demo import private_graph, Process
from ...core.errors import InputError
from ...core.units import MPH_MPS
from ...io.truth import read_truth, VehicleTruth

if TYPE_CHECKING:
    from ...nodes.fault_listener import Heard, HeardReading

_START_S, _AFTER_S = 180.0, 4.0  # the first start compiles the kernels
_QUIET_S = 2.0  # time at the start in which no output is expected
_NEAR_M, _WRONG_MPH, _WRONG_SIGMAS = 4.0, 1.0, 4.0
_SLACK_NS = 60_000_000  # by which stamps may differ from those of the truth
_APART_PERIOD_S = 0.2  # period of cameras that expose at different times
_HOUR_NS = 3_600_000_000_000
_RESPAWN_S = 0.2  # as in the launch file
_KILLS = ('kill_stereo_sync_node', 'kill_tracker_node', 'kill_speed_node')
_KILLS_ONE = ('kill_speed_camera_node',)
# Helper processes of the measuring node, which goes on without them.
_KILLS_HELPER = {'kill_search_process': 'search_process', 'kill_pass_process': 'pass_process'}
_APPROXIMATE = ('right_5_ms', 'right_20_ms', 'right_50_ms', 'exposed_apart')
_ALWAYS = (*_APPROXIMATE, 'swapped', 'jitter', 'no_info')  # active from the start
# Faults at the start, before anything is known: the fault, and its duration, s.
_AT_START = {'start_with_info_nan': ('info_nan', 1.0),
             'start_uncalibrated': ('info_uncalibrated', 1.0)}
# Other parameters of the camera's process, and of the node that pairs the images.
_COMPRESSED = {
    'truncated_file': ('short_data', ['decode:=false'], ['image_transport:=compressed'])}
_NO_PROFILE = 'camera_without_profile'  # for large images over DDS
_PROFILE = 'FASTRTPS_DEFAULT_PROFILES_FILE'


@dataclass(frozen=True)
class _Row:
    """
    The result of a fault.

    :param fault: name of the fault.
    :param alive: whether all nodes that were not killed were running in the end.
    :param readings: number of live readings compared with the truth.
    :param wrong: number of wrong ones among these.
    :param measured: number of measured passes compared with the truth.
    :param wrong_passes: number of wrong ones among these.
    :param worst_sigmas: greatest error of a measured pass in sigmas.
    :param silent_s: time from the end of the fault to the next right reading; None for none.
    :param said: findings on /diagnostics during the fault or soon after.
    :param back: whether all levels were OK again before the end of the stream.
    """

    fault: str
    alive: bool
    readings: int
    wrong: int
    measured: int
    wrong_passes: int
    worst_sigmas: float
    silent_s: Optional[float]
    said: str
    back: bool


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``faults``."""
    parser.add_argument('traffic', type=Path,
                        help='folder written by traffic --bag: bag, site.yaml, truth.csv')
    parser.add_argument('--fault', action='append', metavar='NAME',
                        help='play only this fault; may be given several times')
    parser.add_argument('--single', action='store_true',
                        help='one node, speed_camera_node, instead of three')
    parser.add_argument('--rate', type=float, default=1.0, help='speed of the replay')
    parser.add_argument('--start', type=float, default=5.0, help='start of the fault, s')
    parser.add_argument('--length', type=float, default=3.0, help='length of the fault, s')
    parser.add_argument('--play', type=float, default=18.0,
                        help='seconds of the bag that are played')


def run(args: argparse.Namespace) -> int:
    """Run the faults one after the other, and print a row for each."""
    private_graph()
    from ...nodes.faulty_replay_node import FAULTS
    names = [*FAULTS, *_AT_START, *_COMPRESSED, _NO_PROFILE,
             *(_KILLS_ONE if args.single else _KILLS), *_KILLS_HELPER]
    names.remove('exposed_apart')  # needs a bag made for it
    known = [*names, 'exposed_apart']
    for name in args.fault or ():
        if name not in known:
            raise InputError('faults', '--fault', name, 'one of ' + ', '.join(known))
    truth = read_truth(args.traffic / 'truth.csv')
    print('| fault | nodes live | readings | wrong | measured passes | wrong | worst, σ '
          '| right again after, s | /diagnostics | OK again |\n'
          '|---|---|---|---|---|---|---|---|---|---|', flush=True)
    good = True
    for name in args.fault or names:
        row = _one(name, args, truth)
        good &= row.alive and not row.wrong and not row.wrong_passes
        after = '-' if row.silent_s is None else f'{row.silent_s:.1f}'
        print(f'| `{row.fault}` | {"yes" if row.alive else "NO"} | {row.readings} | {row.wrong} '
              f'| {row.measured} | {row.wrong_passes} | {row.worst_sigmas:.1f} | {after} '
              f'| {row.said} | {"yes" if row.back else "no"} |', flush=True)
    return 0 if good else 1


def _one(name: str, args: argparse.Namespace, truth: Sequence[VehicleTruth]) -> _Row:
    """Play the bag with one fault."""
    from ...nodes.fault_listener import FaultListener
    fault, sending, pairing = _COMPRESSED.get(name, (name, [], []))
    if name in _APPROXIMATE:
        pairing = ['approximate_sync:=true', 'approximate_sync_tolerance_seconds:=0.06']
    site = f'site:={args.traffic / "site.yaml"}'
    commands = [('speed_camera_node', site, *pairing)] if args.single else [
        ('stereo_sync_node', *pairing), ('tracker_node', site), ('speed_node',)]
    begins_s, length_s = (0.0, 1e6) if name in _ALWAYS else (args.start, args.length)
    if name in _AT_START:
        begins_s = 0.0
        fault, length_s = _AT_START[name]
    if name in (*_KILLS, *_KILLS_ONE, *_KILLS_HELPER, _NO_PROFILE):
        fault = 'none'
    with ExitStack() as stack:
        nodes = {command[0]: stack.enter_context(Process(*command)) for command in commands}
        listener = FaultListener()
        stack.callback(listener.close)
        if not listener.spin(_START_S, lambda: listener.connected(
                '/vehicle_speed', '/passes', '/tracks', '/diagnostics')
                and _measures(listener.heard)):
            raise InputError('faults', 'graph', 'nodes that do not connect', 'all of them')
        chain = [] if args.single else ['wait_for_topics:=stereo/image_pair tracks']
        profile = os.environ.pop(_PROFILE, None) if name == _NO_PROFILE else None
        replay = stack.enter_context(Process(
            'faulty_replay_node', f'bag:={args.traffic / "bag"}', f'rate:={args.rate}', *chain,
            *sending, f'fault:={fault}', f'fault_start:={begins_s}',
            f'fault_length:={length_s}', f'length:={args.play}',
            f'exposures:={_exposures(truth)}'))
        if profile is not None:
            os.environ[_PROFILE] = profile
        if not listener.spin(_START_S, lambda: bool(listener.heard.begun_s)):
            raise InputError('faults', name, f'no replay within {_START_S:.0f} s', 'one')
        begun_s = listener.heard.begun_s
        until_s = begun_s + args.start / args.rate
        ended_s = begun_s + (0.0 if name in (*_ALWAYS, _NO_PROFILE)
                             else (begins_s + length_s) / args.rate)
        listener.spin(max(until_s - time.monotonic(), 0.0), replay.ended)
        if name in (*_KILLS, *_KILLS_ONE):
            killed = name.partition('_')[2]
            nodes[killed].process.kill()
            listener.spin(_RESPAWN_S, lambda: False)
            command = next(c for c in commands if c[0] == killed)
            nodes[killed] = stack.enter_context(Process(*command))
            ended_s = time.monotonic()
        elif name in _KILLS_HELPER:
            node = nodes['speed_camera_node' if args.single else 'tracker_node']
            os.kill(helper_of(node.process.pid, _KILLS_HELPER[name]), signal.SIGKILL)
            ended_s = time.monotonic()
        rest_s = max(begun_s + args.play / args.rate - time.monotonic(), 0.0)
        listener.spin(rest_s, replay.ended)
        back = not any(_newest(listener.heard).values())
        listener.spin(_AFTER_S, lambda: False)
        alive = not any(node.ended() for node in nodes.values())
    return _row(name, listener.heard, truth, (begun_s, ended_s, args.play / args.rate), alive,
                back)


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


def _newest(heard: Heard) -> dict[str, int]:
    """Return the latest level of each diagnostic task."""
    return {name: level for _, name, level, _ in heard.levels}


def _row(name: str, heard: Heard, truth: Sequence[VehicleTruth],
         times_s: tuple[float, float, float], alive: bool, back: bool) -> _Row:
    """
    Return the result of a fault.

    :param times_s: start of the stream, end of the fault, and playing time.
    """
    begun_s, ended_s, played_s = times_s
    errors = [(reading, error) for reading in heard.readings
              if (error := _error(reading, heard, truth)) is not None]
    wrong = [(reading, error) for reading, error in errors if _is_wrong(*error)]
    worst = [max(errors, key=lambda one: abs(one[1][0] / one[1][1]))] if errors else []
    for what, told in ('wrong', wrong), ('worst reading', worst):
        for reading, (error_mps, std_mps) in told:
            print(f'{name}: {what}: {reading.frame_id} {reading.at_s - begun_s:.1f} s after the '
                  f'start: {reading.speed_mps / MPH_MPS:.2f} ± {std_mps / MPH_MPS:.2f} mph, off '
                  f'by {error_mps / MPH_MPS:+.2f}, {error_mps / std_mps:+.1f} sigma',
                  file=sys.stderr)
    right_after = [r.at_s - ended_s for r, e in errors if r.at_s > ended_s and not _is_wrong(*e)]
    passes = [e for p in heard.passes if (e := _pass_error(p, heard, truth)) is not None]
    said = dict.fromkeys(
        f'{task.rpartition(": ")[2]}: {"WARN" if level == 1 else "ERROR"} {_short(message)}'
        for at_s, task, level, message in heard.levels
        if level and begun_s + _QUIET_S < at_s < begun_s + played_s)
    return _Row(name, alive, len(errors), len(wrong), len(passes),
                sum(_is_wrong(*e) for e in passes),
                max((abs(mps / std) for mps, std in passes), default=0.0),
                min(right_after, default=None), '; '.join(list(said)[:4]) or 'OK', back)


def _short(message: str) -> str:
    """Return a message without its numbers, so that repeats are equal."""
    return ' '.join('N' if word.replace('.', '').replace('-', '').replace('+', '').isdigit()
                    else word for word in message.split(';')[0].split(':')[0].split())


def _is_wrong(error_mps: float, std_mps: float) -> bool:
    return abs(error_mps) > _WRONG_MPH * MPH_MPS and abs(error_mps) > _WRONG_SIGMAS * std_mps


def _vehicle_at(ns: int, place: tuple[float, float, float], truth: Sequence[VehicleTruth]
                ) -> Optional[tuple[int, int, int]]:
    """
    Return the vehicle at a position; stamps may be wrong by a step or an hour.

    :return: index of the vehicle, error of the stamp, ns, and the row of its truth.
    """
    best = None
    for index, vehicle in enumerate(truth):
        for off_ns in (0, -_HOUR_NS, _HOUR_NS):
            at = ns + off_ns
            row = int(np.argmin(np.abs(vehicle.stamps_ns - at)))
            if abs(int(vehicle.stamps_ns[row]) - at) > _SLACK_NS:
                continue
            away_m = float(np.linalg.norm(vehicle.position_m[row] - place))
            if away_m < _NEAR_M and (best is None or away_m < best[0]):
                best = away_m, (index, off_ns, row)
    return None if best is None else best[1]


def _error(reading: HeardReading, heard: Heard, truth: Sequence[VehicleTruth]
           ) -> Optional[tuple[float, float]]:
    place = heard.places.get((reading.ns, reading.frame_id))
    found = None if place is None else _vehicle_at(reading.ns, place, truth)
    if found is None:
        return None
    index, _, row = found
    return reading.speed_mps - float(truth[index].speed_mps[row]), reading.std_mps


def _pass_error(told: dict[str, object], heard: Heard, truth: Sequence[VehicleTruth]
                ) -> Optional[tuple[float, float]]:
    """
    Return the error of a measured pass relative to the mean true speed, and its 1-sigma.

    The mean is over the time of the pass as its message gives it. The positions heard only tell
    which vehicle it is: on a busy machine few of them are published.
    """
    speed, std = told['speed_mps'], told['speed_std_mps']
    if not isinstance(speed, float) or not isinstance(std, float):
        return None
    first, last = told['first_stamp_ns'], told['last_stamp_ns']
    assert isinstance(first, int) and isinstance(last, int)  # noqa: S101 (for the types)
    seen = [found[:2] for (ns, frame), place in heard.places.items()
            if frame == f'vehicle_{told["track"]}' and first <= ns <= last
            and (found := _vehicle_at(ns, place, truth)) is not None]
    if not seen:
        return None
    (index, off_ns), _ = Counter(seen).most_common(1)[0]
    vehicle = truth[index]
    rows = np.flatnonzero((vehicle.stamps_ns >= first + off_ns - _SLACK_NS)
                          & (vehicle.stamps_ns <= last + off_ns + _SLACK_NS))
    return speed - float(vehicle.speed_mps[rows].mean()), std
