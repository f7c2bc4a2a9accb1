# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The trials of ``faults``: how each fault is played, and what is expected of the nodes.

Times are those of ``traffic --minutes 0.35 --vehicles 6 --lanes 2 --seed 8``. On this road a
vehicle is in view in the first half second, and the next one is in reach of the detector after
4 s; of a fault that ends after 8 s, one is in reach until 8.5 s and from 12 s on.
"""
from __future__ import annotations

from typing import Mapping, NamedTuple, Optional

OK, WARN, ERROR = range(3)  # levels of DiagnosticStatus
ALWAYS_S = 1e6
SLACK = 4.0  # a machine may be this much slower than the limits of silence ask for

# Why a level of OK is right, or a silence of more than 2 s.
_FULL_SIZE = 'large images go through the socket, and those lost are counted'
_RESTARTS = 'a node that starts again knows of no fault; the others miss it after 2 s'
_NEXT_VEHICLE = 'the next vehicle is in reach 4.2 s after the start'
_ANEW = 'the pace is learnt anew, and tracks start again: the next vehicle is in reach after 4 s'


class Trial(NamedTuple):
    """
    How a fault is played, and what is expected.

    :param level: least level that /diagnostics must reach because of the fault.
    :param task: task that must reach it; empty for any.
    :param why_ok: why the level may be OK.
    :param most: highest level that may be reached; ``level`` where it is not given.
    :param takes_s: duration up to which a fault may be a WARN although ``level`` is ERROR.
    :param silent_s: longest time from the end of the fault to the next right reading.
    :param why_silent: why it is longer than the 2 s of most faults.
    :param reads: whether there must be readings.
    :param stream: fault of ``faulty_replay_node``; None for the name of the trial.
    :param first_s: start of the fault; None for the option ``--start``.
    :param length_s: duration of the fault; None for the option ``--length``.
    :param shifts_s: by how much stamps may be off during the fault, besides 0.
    :param sending: parameters of the camera's process.
    :param pairing: parameters of the node that pairs the images.
    :param approximate: whether that node pairs images with different stamps.
    :param kill: node that is killed and started again.
    :param kill_helper: helper process of the measuring node that is killed.
    :param no_profile: processes without the DDS profile for large images: camera, nodes.
    """

    level: int
    task: str = ''
    why_ok: str = ''
    most: Optional[int] = None
    takes_s: float = 0.0
    silent_s: float = 2.0
    why_silent: str = ''
    reads: bool = True
    stream: Optional[str] = None
    first_s: Optional[float] = None
    length_s: Optional[float] = None
    shifts_s: tuple[float, ...] = ()
    sending: tuple[str, ...] = ()
    pairing: tuple[str, ...] = ()
    approximate: bool = False
    kill: str = ''
    kill_helper: str = ''
    no_profile: tuple[str, ...] = ()

    @property
    def always(self) -> bool:
        """Return whether the fault lasts from the start to the end."""
        return self.first_s == 0.0 and self.length_s == ALWAYS_S


def _always(level: int, task: str, silent_s: float = 5.0, why_silent: str = _NEXT_VEHICLE, *,
            reads: bool = True, approximate: bool = False) -> Trial:
    """Return a trial with a fault that does not end."""
    return Trial(level, task, silent_s=silent_s, why_silent=why_silent, reads=reads,
                 approximate=approximate, first_s=0.0, length_s=ALWAYS_S)


def _start(level: int, stream: str, length_s: float) -> Trial:
    """Return a trial with a fault at the start, before anything is known."""
    return Trial(level, 'pipeline', silent_s=5.0, why_silent=_NEXT_VEHICLE, stream=stream,
                 first_s=0.0, length_s=length_s)


def _no_profile(*processes: str) -> Trial:
    return Trial(OK, why_ok=_FULL_SIZE, most=WARN, silent_s=5.0, why_silent=_NEXT_VEHICLE,
                 stream='none', first_s=0.0, length_s=ALWAYS_S, no_profile=processes)


def _kill(node: str) -> Trial:
    return Trial(OK, why_ok=_RESTARTS, most=ERROR, stream='none', kill=node)


def _step(step_s: float) -> Trial:
    """Return a trial with a small step, which is found in a pace of 20 intervals."""
    return Trial(WARN, 'stamps', silent_s=5.0, why_silent=_ANEW, first_s=6.0, length_s=2.0,
                 shifts_s=(step_s,))


_HOUR_S = 3600.0
_PAIRS, _LEFT, _RIGHT = 'pairs', 'left camera', 'right camera'
TRIALS: Mapping[str, Trial] = {
    'none': Trial(OK, why_ok='there is no fault'),
    'truncated_file': Trial(WARN, _PAIRS, stream='short_data', sending=('decode:=false',),
                            pairing=('image_transport:=compressed',)),
    'short_data': Trial(WARN, _PAIRS),
    'other_size': Trial(WARN, _PAIRS),
    'no_size': Trial(WARN, _PAIRS),
    'odd_encoding': Trial(WARN, _PAIRS),
    'float_encoding': Trial(WARN, _PAIRS),
    'black': Trial(ERROR, _LEFT, takes_s=2.5),
    'frozen_pair': Trial(ERROR, _LEFT, takes_s=2.5),
    'frozen_right': Trial(ERROR, _RIGHT, takes_s=2.5),
    'swapped': _always(ERROR, 'pipeline', reads=False),
    'no_right': Trial(ERROR, _RIGHT, takes_s=2.9),
    'no_images': Trial(ERROR, _LEFT, takes_s=2.9),
    'lost_30_percent': Trial(WARN, _PAIRS),
    'twice': Trial(WARN, _LEFT),
    'disordered': Trial(WARN, _RIGHT),
    'right_delayed': Trial(OK, why_ok='an image that is 50 ms late is waited for'),
    'right_5_ms': _always(ERROR, 'stamps', approximate=True),
    'right_20_ms': _always(ERROR, 'stamps', 8.0, 'two vehicles have to determine the lag',
                           approximate=True),
    'right_50_ms': _always(ERROR, 'stamps', reads=False, approximate=True),
    'exposed_apart': _always(WARN, 'stamps', approximate=True),
    'clock_30_ms_on': _step(0.03),
    'clock_30_ms_back': _step(-0.03),
    'clock_half_a_second_back': Trial(WARN, _LEFT, silent_s=5.0, why_silent=_ANEW,
                                      shifts_s=(-0.5,)),
    'clock_an_hour_on': Trial(WARN, 'pipeline', shifts_s=(_HOUR_S,)),
    'clock_an_hour_back': Trial(WARN, 'pipeline', shifts_s=(-_HOUR_S,)),
    'jitter': _always(WARN, 'stamps'),
    'stamp_an_hour_on': Trial(WARN, _PAIRS),
    'pair_an_hour_on': Trial(WARN, 'pipeline', shifts_s=(_HOUR_S,)),
    'stamp_of_zero': Trial(WARN, _PAIRS),
    'stamps_of_zero': Trial(ERROR, _LEFT, takes_s=2.9),
    'info_nan': Trial(WARN, 'pipeline'),
    'start_with_info_nan': _start(WARN, 'info_nan', 1.0),
    'info_uncalibrated': Trial(WARN, 'pipeline'),
    'start_uncalibrated': _start(WARN, 'info_uncalibrated', 1.0),
    # At 20 pairs a second more pairs wait than are kept.
    'start_without_info': _start(ERROR, 'no_info', 4.0),
    'no_info': _always(ERROR, 'pipeline', reads=False),
    'info_other': Trial(WARN, 'pipeline', silent_s=3.0,
                        why_silent='measuring starts anew with another calibration, and back'),
    'camera_without_profile': _no_profile('camera'),
    'all_without_profile': _no_profile('camera', 'nodes'),
    'kill_search_process': Trial(WARN, 'pipeline', stream='none', kill_helper='search_process'),
    'kill_pass_process': Trial(WARN, 'pipeline', stream='none', kill_helper='pass_process'),
    'kill_speed_camera_node': _kill('speed_camera_node'),
    'kill_tracker_node': _kill('tracker_node'),
    'kill_stereo_sync_node': _kill('stereo_sync_node'),
    'kill_speed_node': _kill('speed_node'),
}
_SPECIAL_BAG = ('exposed_apart',)  # needs a bag of its own


def played(nodes: tuple[str, ...]) -> list[str]:
    """
    Return the trials that can be played with a graph and any bag.

    :param nodes: names of the nodes of the graph.
    """
    return [name for name, trial in TRIALS.items()
            if name not in _SPECIAL_BAG and (not trial.kill or trial.kill in nodes)]
