# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Finished passes, and the tracks after a pair, as JSON for topics, databases and evidence.

``pass.schema.json`` and ``track_states.schema.json`` beside this module describe the formats.
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
    Return a name for a run of the instrument that is unique across machines.

    :param now: start of the run; None for the present time.
    :return: the time in UTC, so that names sort, and 32 random bits.
    """
    now = datetime.now(timezone.utc) if now is None else now.astimezone(timezone.utc)
    return f'{now:%Y%m%dT%H%M%SZ}-{secrets.token_hex(4)}'


def track_id(run: str, track: int) -> str:
    """
    Return an id for a pass that is unique among all passes of all runs.

    :param run: name of the run of the instrument, unique.
    :param track: number of the track, never reused within a run.
    """
    return f'{run}-{track:06d}'


def pass_record(run: str, result: PassResult) -> dict[str, Any]:
    """
    Return a pass as plain values: SI units, stamps in ns, None for unknown values.

    :param run: name of the run of the instrument, unique.
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
    Return the states of all tracks after a pair, as one line of JSON.

    :param run: name of the run of the instrument.
    :param pair: the pair; both of its stamps are included.
    :param updates: updates of the tracks by this pair; may be empty.
    """
    return json.dumps({
        'stereo_speed_tracks': FORMAT,
        'run': run,
        'stamp_ns': pair.stamp_ns,
        'right_stamp_ns': pair.right_stamp_ns,
        'tracks': [_state(run, update) for update in updates],
    }, allow_nan=False)


def _state(run: str, update: TrackUpdate) -> dict[str, Any]:
    """Return a track's state; it has a speed only if confirmed."""
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
