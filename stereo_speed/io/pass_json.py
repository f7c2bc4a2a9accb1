# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A finished pass, and the tracks of a pair, as JSON: for topics, databases and evidence.

``pass.schema.json`` and ``track_states.schema.json`` beside this module describe both.
"""
from __future__ import annotations

import dataclasses
from datetime import datetime, timezone
import json
from pathlib import Path
import secrets
from typing import Any, Optional, Sequence

from ..core.passes import PassResult, VehicleKind
from ..core.records import StereoPair, TrackState, TrackUpdate

FORMAT = 1
PASS_SCHEMA = Path(__file__).with_name('pass.schema.json')
TRACK_STATES_SCHEMA = Path(__file__).with_name('track_states.schema.json')


def new_run(now: Optional[datetime] = None) -> str:
    """
    Return a name for a run of the instrument that no other run has, on any machine.

    :param now: when it begins; None for the present moment.
    :return: the time in UTC, so that names sort, and 32 random bits.
    """
    now = datetime.now(timezone.utc) if now is None else now.astimezone(timezone.utc)
    return f'{now:%Y%m%dT%H%M%SZ}-{secrets.token_hex(4)}'


def track_id(run: str, track: int) -> str:
    """
    Return what names a vehicle's pass among all that were ever measured.

    :param run: names the run of the instrument; no two runs of one share it.
    :param track: number of the track, never reused within a run.
    """
    return f'{run}-{track:06d}'


def pass_record(run: str, result: PassResult) -> dict[str, Any]:
    """
    Return a pass as plain values: SI units, stamps in ns, None for what is not known.

    :param run: names the run of the instrument; no two runs of one share it.
    :param result: measured or rejected.
    """
    first_mps, last_mps, max_mps = result.profile_mps
    return {
        'stereo_speed_pass': FORMAT,
        'id': track_id(run, result.track),
        'run': run,
        'track': result.track,
        'lane': result.lane,
        'lane_to': result.lane_to,
        'direction': None if result.direction is None else str(result.direction),
        'first_stamp_ns': result.first_ns,
        'last_stamp_ns': result.last_ns,
        'pairs': result.pairs,
        'verdict': str(result.verdict),
        'reason': str(result.reason),
        'end': str(result.end),
        'speed_mps': result.speed_mps,
        'speed_std_mps': result.speed_std_mps,
        'std_parts_mps': None if result.budget is None else {
            'matching': result.budget.matching_mps, 'path': result.budget.path_mps,
            'stamps': result.budget.stamps_mps, 'calibration': result.budget.calibration_mps},
        'profile_mps': {'first': first_mps, 'last': last_mps, 'max': max_mps},
        'second': None if result.second is None else dataclasses.asdict(result.second),
        'vehicle': None if result.vehicle is None else _vehicle(result.vehicle),
    }


def _vehicle(vehicle: VehicleKind) -> dict[str, Any]:
    """Return class and size of a vehicle."""
    size = dataclasses.asdict(vehicle)
    return {'class': str(size.pop('name')), **size}


def pass_text(run: str, result: PassResult) -> str:
    """Return :func:`pass_record` as one line of JSON."""
    return json.dumps(pass_record(run, result), allow_nan=False)


def track_states_text(run: str, pair: StereoPair, updates: Sequence[TrackUpdate]) -> str:
    """
    Return what is known of all tracks after one pair, as one line of JSON.

    :param run: names the run of the instrument.
    :param pair: the pair, both of whose stamps are told.
    :param updates: of the tracks that followed their vehicles in it; there may be none.
    """
    return json.dumps({
        'stereo_speed_tracks': FORMAT,
        'run': run,
        'stamp_ns': pair.stamp_ns,
        'right_stamp_ns': pair.right_stamp_ns,
        'tracks': [_state(run, update) for update in updates],
    }, allow_nan=False)


def _state(run: str, update: TrackUpdate) -> dict[str, Any]:
    """Return a track's state; a speed only where it is a measurement."""
    measured = update.state is TrackState.CONFIRMED
    return {
        'id': track_id(run, update.track),
        'track': update.track,
        'frame_id': f'vehicle_{update.track}',
        'lane': update.lane,
        'state': str(update.state),
        'measured': measured,
        'speed_mps': float(update.speed_mps) if measured else None,
        'speed_std_mps': float(update.speed_std_mps) if measured else None,
        's_m': float(update.s_m),
        'lateral_m': float(update.lateral_m),
    }
