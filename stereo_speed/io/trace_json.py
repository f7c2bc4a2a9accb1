# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""How a pass came about, and the rig it was seen by, as JSON values and back, without loss."""
from __future__ import annotations

import dataclasses
import json
from typing import Any, Mapping, Optional

import numpy as np

from .pass_json import pass_id
from ..core.errors import InputError
from ..core.passes import (
    Direction, PassResult, SecondEstimate, SpeedBudget, TrackEnd, VehicleClass, VehicleKind,
    Verdict)
from ..core.records import Array, InitialFront, RigMotion, TrackState, TrackUpdate
from ..core.trace import OtherFront, PassTrace, TracePair
from ..geometry.camera import Camera
from ..geometry.rig import StereoRig

FORMAT = 1


def trace_record(trace: PassTrace) -> dict[str, Any]:
    """Return a trace as plain values; floats come back the same."""
    return {'track': trace.track, 'seed': trace.seed, 'lane': trace.lane,
            'front': {'frame': trace.front.frame, 'std_px': trace.front.std_px,
                      'left_px': trace.front.left_px.tolist(),
                      'right_px': trace.front.right_px.tolist()},
            'particles': trace.particles, 'seen_mps': trace.seen_mps,
            'pairs': [_pair_record(pair) for pair in trace.pairs]}


def trace_of(data: Any, where: object) -> PassTrace:
    """
    Return the trace that plain values describe.

    :param data: as of :func:`trace_record`.
    :param where: file or topic, for errors.
    :raises InputError: values that are none.
    """
    try:
        front = data['front']
        return PassTrace(
            int(data['track']), int(data['seed']), str(data['lane']),
            InitialFront(int(front['frame']), _array(front['left_px'], (4, 2)),
                         _array(front['right_px'], (4, 2)), float(front['std_px'])),
            int(data['particles']), _optional(data['seen_mps']),
            tuple(_pair_of(pair, int(data['track'])) for pair in data['pairs']))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(where, 'trace', f'{type(error).__name__}: {error}',
                         'how a pass came about') from None


def trace_text(run: str, result: PassResult) -> str:
    """
    Return how a pass came about, and its speed in each pair, as one line of JSON.

    :param run: names the run of the instrument.
    :param result: measured or rejected.
    """
    profile = [[ns, result.smoothed[ns], result.smoothed_std.get(ns)]
               for ns in sorted(result.smoothed)]
    return json.dumps({
        'stereo_speed_trace': FORMAT, 'id': pass_id(run, result), 'run': run, 'profile': profile,
        'trace': None if result.trace is None else trace_record(result.trace)}, allow_nan=False)


def result_of(told: str, traced: str, where: object) -> PassResult:
    """
    Return the result that a pass's message and its trace's message describe together.

    :param told: as of :func:`.pass_json.pass_text`.
    :param traced: as of :func:`trace_text`, of the same pass.
    :param where: topic, for errors.
    :raises InputError: other messages.
    """
    try:
        data, more = json.loads(told), json.loads(traced)
        budget, second, direction, vehicle = (
            data[key] for key in ('std_parts_mps', 'second', 'direction', 'vehicle'))
        smoothed = {int(ns): float(mps) for ns, mps, _ in more['profile']}
        stds = {int(ns): float(std) for ns, _, std in more['profile'] if std is not None}
        return PassResult(
            track=int(data['track']), lane=str(data['lane']), lane_to=str(data['lane_to']),
            first_ns=int(data['first_stamp_ns']), last_ns=int(data['last_stamp_ns']),
            pairs=int(data['pairs']), speed_mps=_optional(data['speed_mps']),
            speed_std_mps=_optional(data['speed_std_mps']), verdict=Verdict(data['verdict']),
            reason=str(data['reason']), smoothed=smoothed, smoothed_std=stds,
            budget=None if budget is None else SpeedBudget(
                *(float(budget[key]) for key in ('matching', 'path', 'stamps', 'calibration'))),
            end=TrackEnd(data['end']),
            second=None if second is None else SecondEstimate(
                _optional(second['speed_mps']), _optional(second['speed_std_mps']),
                int(second['pairs'])),
            direction=None if direction is None else Direction(direction),
            vehicle=None if vehicle is None else _vehicle_of(vehicle),
            trace=None if more['trace'] is None else trace_of(more['trace'], where))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(where, 'pass', f'{type(error).__name__}: {error}',
                         'a pass and its trace as JSON') from None


def _vehicle_of(data: Mapping[str, Any]) -> VehicleKind:
    return VehicleKind(
        VehicleClass(data['class']), float(data['probability']), float(data['width_m']),
        float(data['width_std_m']), _optional(data['height_m']), _optional(data['height_std_m']))


def rig_record(rig: StereoRig) -> dict[str, Any]:
    """Return a rig as plain values; floats come back the same."""
    return {'left': _camera_record(rig.left), 'right': _camera_record(rig.right),
            'R': rig.R.tolist(), 't': rig.t.tolist(), 'frame_id': rig.frame_id,
            'drift_rad': list(rig.drift_rad)}


def rig_of(data: Any, where: object) -> StereoRig:
    """
    Return the rig that plain values describe.

    :param data: as of :func:`rig_record`.
    :param where: file or topic, for errors.
    :raises InputError: values that are none.
    """
    try:
        pan, tilt, roll = (float(angle) for angle in data['drift_rad'])
        return StereoRig(_camera_of(data['left']), _camera_of(data['right']),
                         np.array(data['R'], dtype=np.float64), np.array(data['t']),
                         str(data['frame_id']), (pan, tilt, roll))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(where, 'calibration', f'{type(error).__name__}: {error}',
                         'a calibrated rig') from None


def _camera_record(camera: Camera) -> dict[str, Any]:
    return {'name': camera.name, 'width_px': camera.width_px, 'height_px': camera.height_px,
            'K': camera.K.tolist(), 'D': camera.D.tolist(), 'model': camera.model}


def _camera_of(data: Mapping[str, Any]) -> Camera:
    return Camera(str(data['name']), int(data['width_px']), int(data['height_px']),
                  np.array(data['K'], dtype=np.float64), np.array(data['D'], dtype=np.float64),
                  str(data['model']))


def _pair_record(pair: TracePair) -> dict[str, Any]:
    return {'stamp_ns': pair.stamp_ns, 'right_stamp_ns': pair.right_stamp_ns,
            'right_came_ns': pair.right_came_ns, 'stamp_error_s': pair.stamp_error_s,
            'particles': pair.particles,
            'motion': None if pair.motion is None else dataclasses.asdict(pair.motion),
            'update': None if pair.update is None else _update_record(pair.update),
            'others': [{'track': o.track, 'left_px': o.left_px.tolist(),
                        'right_px': o.right_px.tolist()} for o in pair.others]}


def _pair_of(data: Mapping[str, Any], track: int) -> TracePair:
    motion = data['motion']
    return TracePair(
        int(data['stamp_ns']), int(data['right_stamp_ns']),
        None if data['particles'] is None else int(data['particles']),
        None if motion is None else RigMotion(tuple(motion['sway_rad']),
                                              tuple(motion['drift_rad'])),
        None if data['update'] is None else _update_of(
            data['update'], int(data['stamp_ns']), track),
        tuple(OtherFront(int(o['track']), _array(o['left_px'], (4, 2)),
                         _array(o['right_px'], (4, 2))) for o in data['others']),
        float(data['stamp_error_s']),
        None if data['right_came_ns'] is None else int(data['right_came_ns']))


def _update_record(update: TrackUpdate) -> dict[str, Any]:
    return {'lane': update.lane, 'state': str(update.state),
            'speed_mps': update.speed_mps, 'speed_std_mps': update.speed_std_mps,
            's_m': update.s_m, 'lateral_m': update.lateral_m,
            **{name: getattr(update, name).tolist() for name, _ in _ARRAYS}}


_ARRAYS = (('position_m', (3,)), ('position_cov_m2', (3, 3)), ('axes', (3, 3)),
           ('quad_left_px', (4, 2)), ('quad_right_px', (4, 2)))


def _update_of(data: Mapping[str, Any], stamp_ns: int, track: int) -> TrackUpdate:
    return TrackUpdate(
        stamp_ns=stamp_ns, track=track, lane=str(data['lane']), state=TrackState(data['state']),
        speed_mps=float(data['speed_mps']), speed_std_mps=float(data['speed_std_mps']),
        s_m=float(data['s_m']), lateral_m=float(data['lateral_m']),
        **{name: _array(data[name], shape) for name, shape in _ARRAYS})


def _array(values: Any, shape: tuple[int, ...]) -> Array:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f'an array {array.shape} instead of {shape}')
    return array


def _optional(value: Any) -> Optional[float]:
    return None if value is None else float(value)
