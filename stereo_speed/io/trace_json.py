# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Convert the trace of a pass, and its rig, to JSON values and back without loss."""
from __future__ import annotations

import dataclasses
from functools import lru_cache
import json
from typing import Any, get_args, get_origin, get_type_hints, Mapping, Optional, Union

import numpy as np
from numpy.typing import NDArray

from .pass_json import track_id
from ..core.config import ConfigRecord, Record
from ..core.errors import InputError
from ..core.passes import (
    Direction, PassResult, SecondEstimate, SpeedBudget, TrackEnd, VehicleKind, Verdict)
from ..core.records import TrackUpdate
from ..core.trace import PassTrace, TracePair
from ..geometry.camera import Camera
from ..geometry.rig import StereoRig

FORMAT = 1
# Left out because the trace or pair implies them; a calibrated camera has no rotation.
_LEFT_OUT: Mapping[type, tuple[str, ...]] = {
    TrackUpdate: ('stamp_ns', 'track'), Camera: ('rotation',)}
_IF_KNOWN: Mapping[type, tuple[str, ...]] = {  # fields that are rarely known
    TracePair: ('stamp_std_s',), PassTrace: ('rest_std_rad',)}
_SHAPES = {'position_m': (3,), 'position_cov_m2': (3, 3), 'axes': (3, 3), **dict.fromkeys(
    ('left_px', 'right_px', 'quad_left_px', 'quad_right_px'), (4, 2))}


def trace_record(trace: PassTrace) -> dict[str, Any]:
    """Return a trace as plain values, with floats unrounded."""
    return _values(trace)


def trace_of(data: Any, where: object) -> PassTrace:
    """
    Return a trace from plain values.

    :param data: values of :func:`trace_record`.
    :param where: file or topic, for errors.
    :raises InputError: values that describe no trace.
    """
    try:
        track = int(data['track'])
        return _record(PassTrace, data, pairs=tuple(_pair_of(pair, track)
                                                    for pair in data['pairs']))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(where, 'trace', f'{type(error).__name__}: {error}',
                         'the trace of a pass') from None


def _pair_of(data: Mapping[str, Any], track: int) -> TracePair:
    update = None if data['update'] is None else _record(
        TrackUpdate, data['update'], stamp_ns=int(data['stamp_ns']), track=track)
    return _record(TracePair, data, update=update)


def trace_text(run: str, result: PassResult) -> str:
    """
    Return the trace of a pass, and its speed in each pair, as one line of JSON.

    :param run: name of the run of the instrument.
    :param result: measured or rejected.
    """
    profile = [[ns, result.smoothed[ns], result.smoothed_std.get(ns)]
               for ns in sorted(result.smoothed)]
    return json.dumps({
        'stereo_speed_trace': FORMAT, 'id': track_id(run, result.track), 'run': run,
        'profile': profile,
        'trace': None if result.trace is None else trace_record(result.trace)}, allow_nan=False)


def result_of(told: str, traced: str, where: object) -> PassResult:
    """
    Return the result of a pass from the messages of pass and trace.

    :param told: text of :func:`.pass_json.pass_text`.
    :param traced: text of :func:`trace_text` for the same pass.
    :param where: topic, for errors.
    :raises InputError: the messages do not describe a pass.
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
            second=None if second is None else _record(SecondEstimate, second),
            direction=None if direction is None else Direction(direction),
            vehicle=None if vehicle is None else _record(
                VehicleKind, {**vehicle, 'name': vehicle['class']}),
            trace=None if more['trace'] is None else trace_of(more['trace'], where))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(where, 'pass', f'{type(error).__name__}: {error}',
                         'a pass and its trace as JSON') from None


def rig_record(rig: StereoRig) -> dict[str, Any]:
    """Return a rig as plain values, with floats unrounded."""
    return _values(rig)


def rig_of(data: Any, where: object) -> StereoRig:
    """
    Return a rig from plain values.

    :param data: values of :func:`rig_record`.
    :param where: file or topic, for errors.
    :raises InputError: values that describe no rig.
    """
    try:
        return _record(StereoRig, data)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(where, 'calibration', f'{type(error).__name__}: {error}',
                         'a calibrated rig') from None


def _values(record: ConfigRecord) -> dict[str, Any]:
    """Return the fields of a record as JSON types, except those of ``_LEFT_OUT``."""
    return {f.name: _plain(getattr(record, f.name)) for f in dataclasses.fields(record)
            if f.name not in _LEFT_OUT.get(type(record), ()) and not (
                getattr(record, f.name) is None and f.name in _IF_KNOWN.get(type(record), ()))}


def _plain(value: Any) -> Any:
    if hasattr(value, '__dataclass_fields__'):
        return _values(value)
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def _record(kind: type[Record], data: Mapping[str, Any], **known: Any) -> Record:
    """
    Return a record from plain values; fields that older data lack get their defaults.

    :param kind: type of the record.
    :param data: values of :func:`_values`.
    :param known: fields whose values are given.
    """
    of = _types(kind)
    return kind(**known, **{
        f.name: _value(of[f.name], data[f.name], f.name) for f in dataclasses.fields(kind)
        if f.name not in known and f.name not in _LEFT_OUT.get(kind, ())
        and (f.name in data or f.default is dataclasses.MISSING)})


_types = lru_cache(maxsize=None)(get_type_hints)  # types of the fields of a record


def _value(kind: Any, value: Any, name: str) -> Any:
    """Convert a plain value to the type of a record's field."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Union:
        return None if value is None else _value(inner[0], value, name)
    if origin in (np.ndarray, NDArray):  # which of them depends on the versions
        array = np.array(value, dtype=np.float64)
        if array.shape != _SHAPES.get(name, array.shape):
            raise ValueError(f'an array {array.shape} instead of {_SHAPES[name]}')
        return array
    if origin is tuple:
        kinds = inner[:1] * len(value) if Ellipsis in inner else inner
        return tuple(_value(one, item, name) for one, item in zip(kinds, value, strict=True))
    return _record(kind, value) if hasattr(kind, '__dataclass_fields__') else kind(value)


def _optional(value: Any) -> Optional[float]:
    return None if value is None else float(value)
