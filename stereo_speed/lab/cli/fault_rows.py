# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The rows of ``faults``: what came of a trial, and whether that was expected."""
from __future__ import annotations

from dataclasses import dataclass, field
import sys
from typing import Iterable, Mapping, NamedTuple, Optional, Sequence, TYPE_CHECKING

from .fault_trials import ERROR, OK, Trial, WARN
from .fault_truth import Compared, Truth
from ..evaluation.soak import SoakRules
from ...core.units import MPH_MPS

if TYPE_CHECKING:
    from ...nodes.fault_listener import Heard, HeardReading

HEADING = (
    '| fault | nodes live | readings | wrong | measured passes | wrong | on no vehicle | worst, σ '
    '| right again after, s | /diagnostics | OK again | result |\n'
    '|---|---|---|---|---|---|---|---|---|---|---|---|')
_QUIET_S = 2.0  # time at the start in which no output is expected
_RULES = SoakRules()  # readings and passes are wrong by the same rule as readings of a long run
_SAID = 4  # number of findings shown
_LEVELS = {OK: 'OK', WARN: 'WARN', ERROR: 'ERROR'}
# Findings about the machine that runs the trial. They tell nothing about the fault.
_MACHINE = ('measuring does not keep up', 'measuring barely keeps up',
            'pairs were too old when measuring began')


class Times(NamedTuple):
    """
    Times of a trial.

    :param begun_s: steady time of the start of the stream, s.
    :param first_s: steady time of the start of the fault, s.
    :param ended_s: steady time of the end of the fault, s.
    :param ended_ns: stamp of the bag at that time.
    :param played_s: playing time, s.
    """

    begun_s: float
    first_s: float
    ended_s: float
    ended_ns: int
    played_s: float


@dataclass(frozen=True)
class Row:
    """
    The result of a trial.

    :param fault: name of the trial.
    :param alive: whether all nodes that were not killed were running in the end.
    :param readings: number of live readings compared with the truth.
    :param wrong: number of wrong ones among these.
    :param measured: number of measured passes compared with the truth.
    :param wrong_passes: number of wrong ones among these.
    :param nowhere: number of readings and measured passes on no vehicle.
    :param worst_sigmas: greatest error of a measured pass in sigmas.
    :param silent_s: time from the end of the fault to the first right reading of a pair after it;
        None for none.
    :param said: findings on /diagnostics during the fault or soon after.
    :param levels: highest level of each task of /diagnostics since the start of the fault, apart
        from findings about the machine.
    :param back: whether all levels were OK again before the end of the stream.
    """

    fault: str
    alive: bool
    readings: int
    wrong: int
    measured: int
    wrong_passes: int
    nowhere: int
    worst_sigmas: float
    silent_s: Optional[float]
    said: str
    levels: Mapping[str, int] = field(default_factory=dict)
    back: bool = True

    @property
    def is_wrong(self) -> bool:
        """Return whether a reading or a pass is wrong, or on no vehicle."""
        return bool(self.wrong or self.wrong_passes or self.nowhere)

    def failures(self, trial: Trial, length_s: float, rate: float, slack: float) -> list[str]:
        """
        Return what was not as expected.

        :param trial: how the fault was played, and what is expected.
        :param length_s: duration of the fault, s of the bag.
        :param rate: speed of the replay.
        :param slack: multiple of the limit of silence that a slow machine may take.
        """
        highest = max(self.levels.values(), default=OK)
        brief = length_s / rate <= trial.takes_s
        wanted, task = (min(trial.level, WARN), '') if brief else (trial.level, trial.task)
        reached = self.levels.get(task, OK) if task else highest
        most = trial.level if trial.most is None else trial.most
        limit_s = slack * _silent_s(trial, rate)
        found = [
            (not self.alive, 'a node has ended by itself'),
            (self.wrong or self.wrong_passes, 'wrong results'),
            (self.nowhere, 'results on no vehicle'),
            (reached < wanted, f'{task or "/diagnostics"} was at most {_LEVELS[reached]}, '
             f'not {_LEVELS[wanted]}'),
            (highest > most, f'/diagnostics was {_LEVELS[highest]}, not at most {_LEVELS[most]}'),
            (not self.back and not trial.always, '/diagnostics was not OK again'),
            (not self.readings and trial.reads, 'no reading'),
            (self.silent_s is None and self.readings and trial.reads,
             'no right reading after the fault'),
            (self.silent_s is not None and self.silent_s > limit_s and trial.reads,
             f'no right reading for more than {limit_s:.1f} s')]
        return [what for is_so, what in found if is_so]

    def is_late(self, trial: Trial, rate: float) -> bool:
        """Return whether right readings came later than on a machine that keeps up."""
        return self.silent_s is not None and self.silent_s > _silent_s(trial, rate)

    def line(self, failures: list[str], late: bool) -> str:
        """Return the row as a line of the table."""
        after = '-' if self.silent_s is None else f'{self.silent_s:.1f}' + ' (late)' * late
        return (f'| `{self.fault}` | {"yes" if self.alive else "NO"} | {self.readings} '
                f'| {self.wrong} | {self.measured} | {self.wrong_passes} | {self.nowhere} '
                f'| {self.worst_sigmas:.1f} | {after} | {self.said} '
                f'| {"yes" if self.back else "no"} '
                f'| {"FAILED: " + ", ".join(failures) if failures else "as expected"} |')


def row_of(name: str, heard: Heard, truth: Truth, times: Times, alive: bool, back: bool) -> Row:
    """Return the result of a trial, and print its wrong readings and the worst one on stderr."""
    readings = [(reading, truth.of_reading(reading, heard.places)) for reading in heard.readings]
    passes = [(told, truth.of_pass(told, heard.places)) for told in heard.passes
              if told['speed_mps'] is not None]
    compared = [(reading, found) for reading, found in readings if found is not None]
    on = [found for _, found in passes if found is not None]
    _tell_readings(name, compared, times)
    _tell_nowhere(name, [reading for reading, found in readings if found is None], heard, times)
    for told in (told for told, found in passes if found is None):
        print(f'{name}: pass on no vehicle: {told}', file=sys.stderr)
    said, levels = _findings(heard, times)
    return Row(
        name, alive, len(compared), sum(_is_wrong(found) for _, found in compared), len(on),
        sum(map(_is_wrong, on)), len(readings) - len(compared) + len(passes) - len(on),
        max((abs(_sigmas(found)) for found in on), default=0.0),
        min((reading.at_s - times.ended_s for reading, found in compared
             if found.ns >= times.ended_ns and not _is_wrong(found)), default=None),
        '; '.join(said[:_SAID]) or 'OK', levels, back)


def _tell_readings(name: str, compared: Sequence[tuple[HeardReading, Compared]], times: Times
                   ) -> None:
    """Print the wrong readings and the worst one."""
    told = [('wrong', reading, found) for reading, found in compared if _is_wrong(found)]
    if compared:
        told.append(('worst reading', *max(compared, key=lambda one: abs(_sigmas(one[1])))))
    for what, reading, found in told:
        _tell(f'{name}: {what}', reading, times, f'off by {found.error_mps / MPH_MPS:+.2f}, '
              f'{_sigmas(found):+.1f} sigma')


def _tell_nowhere(name: str, readings: Iterable[HeardReading], heard: Heard, times: Times) -> None:
    """Print the readings that are on no vehicle, with their places."""
    for reading in readings:
        place = heard.places.get((reading.ns, reading.frame_id))
        _tell(f'{name}: on no vehicle', reading, times, f'stamp {reading.ns}, ' + (
            'no position heard' if place is None else 'at x, y, z = {:.1f}, {:.1f}, {:.1f} m'
            .format(*place)))


def _findings(heard: Heard, times: Times) -> tuple[list[str], dict[str, int]]:
    """Return what /diagnostics said, and the highest level of each task; see :class:`Row`."""
    said, levels = dict[str, None](), dict[str, int]()
    for at_s, name, level, message in heard.levels:
        if not level or not times.begun_s + _QUIET_S < at_s < times.begun_s + times.played_s:
            continue
        task = name.rpartition(': ')[2]
        said[f'{task}: {_LEVELS[level]} {_short(message)}'] = None  # each once, in order
        if at_s > times.first_s and not _is_machine(message):
            levels[task] = max(level, levels.get(task, OK))
    return list(said), levels


def is_back(heard: Heard) -> bool:
    """Return whether the latest level of each task is OK, apart from findings on the machine."""
    newest = {name: level and not _is_machine(message) for _, name, level, message
              in heard.levels}
    return not any(newest.values())


def _silent_s(trial: Trial, rate: float) -> float:
    """Return the limit of silence; vehicles of a slow replay take longer to come."""
    return trial.silent_s / min(rate, 1.0)


def _tell(what: str, reading: HeardReading, times: Times, how: str) -> None:
    print(f'{what}: {reading.frame_id} {reading.at_s - times.begun_s:.1f} s after the start: '
          f'{reading.speed_mps / MPH_MPS:.2f} ± {reading.std_mps / MPH_MPS:.2f} mph, {how}',
          file=sys.stderr)


def _is_machine(message: str) -> bool:
    """Return whether a message has only findings about the machine."""
    return all(finding.startswith(_MACHINE) for finding in message.split('; '))


def _short(message: str) -> str:
    """Return a message without its numbers, so that repeats are equal."""
    return ' '.join('N' if word.replace('.', '').replace('-', '').replace('+', '').isdigit()
                    else word for word in message.split(';')[0].split(':')[0].split())


def _sigmas(found: Compared) -> float:
    return found.error_mps / found.std_mps


def _is_wrong(found: Compared) -> bool:
    return _RULES.is_wrong(found.error_mps, found.std_mps)
