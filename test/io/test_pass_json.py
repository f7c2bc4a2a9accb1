# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Messages of passes and tracks: schemas, and agreement with the results."""
from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timezone
import json
import math
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from stereo_speed.core.passes import (
    Direction, PassResult, SecondEstimate, SpeedBudget, TrackEnd, VehicleClass, VehicleKind,
    Verdict)
from stereo_speed.core.records import StereoPair, TrackState, TrackUpdate
from stereo_speed.io.pass_json import (
    new_run, PASS_SCHEMA, pass_text, TRACK_STATES_SCHEMA, track_states_text)

RUN = '20261122T063000Z-0123abcd'
BUDGET = SpeedBudget(matching_mps=0.03, path_mps=0.04, stamps_mps=0.0, calibration_mps=0.12)
MEASURED = PassResult(
    track=7, lane='near', first_ns=1_700_000_000_000_000_001, last_ns=1_700_000_002_000_000_001,
    pairs=12, speed_mps=24.5, speed_std_mps=0.13, verdict=Verdict.MEASURED, reason='',
    smoothed={20: 24.6, 10: 24.4}, smoothed_std={}, budget=BUDGET, end=TrackEnd.LEFT_VIEW,
    lane_to='far', direction=Direction.RECEDING)


def valid(text, schema):
    """Validate a message, and return its content."""
    schema = json.loads(schema.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    assert '\n' not in text
    jsonschema.validate(json.loads(text), schema, jsonschema.Draft202012Validator)
    return json.loads(text)


def test_measured_pass_is_written_exactly():
    assert valid(pass_text(RUN, MEASURED), PASS_SCHEMA) == {
        'stereo_speed_pass': 1, 'id': RUN + '-000007', 'run': RUN, 'track': 7, 'lane': 'near',
        'lane_to': 'far', 'direction': 'receding', 'first_stamp_ns': 1_700_000_000_000_000_001,
        'last_stamp_ns': 1_700_000_002_000_000_001, 'pairs': 12, 'verdict': 'measured',
        'reason': '', 'end': 'left_view', 'speed_mps': 24.5, 'speed_std_mps': 0.13,
        'std_parts_mps': {'matching': 0.03, 'path': 0.04, 'stamps': 0.0, 'calibration': 0.12},
        'profile_mps': {'first': 24.4, 'last': 24.6, 'max': 24.6}, 'second': None,
        'vehicle': None}


def test_rejected_pass_has_a_reason_and_no_speed():
    found = valid(pass_text(RUN, MEASURED.rejected('off_path')), PASS_SCHEMA)
    assert (found['verdict'], found['reason'], found['speed_mps'], found['std_parts_mps']) == (
        'rejected', 'off_path', None, None)


@pytest.mark.parametrize('second', [SecondEstimate(24.4, 0.2, 9), SecondEstimate(None, None, 0)])
def test_second_estimate_is_included(second):
    found = valid(pass_text(RUN, replace(MEASURED, second=second)), PASS_SCHEMA)
    assert found['second']['speed_mps'] == second.speed_mps


@pytest.mark.parametrize('name', list(VehicleClass))
def test_vehicle_is_included(name):
    vehicle = VehicleKind(name, 0.8, 2.4, 0.08, 3.1, 0.12)
    found = valid(pass_text(RUN, replace(MEASURED, vehicle=vehicle)), PASS_SCHEMA)['vehicle']
    assert found == {'class': name.value, 'probability': 0.8, 'width_m': 2.4, 'width_std_m': 0.08,
                     'height_m': 3.1, 'height_std_m': 0.12}


def test_schema_refuses_a_measured_pass_without_a_speed():
    with pytest.raises(jsonschema.ValidationError):
        valid(pass_text(RUN, replace(MEASURED, speed_mps=None)), PASS_SCHEMA)


def test_non_finite_numbers_are_never_written():
    with pytest.raises(ValueError):
        pass_text(RUN, replace(MEASURED, speed_mps=math.nan))


def test_run_names_are_unique():
    now = datetime(2026, 11, 22, 6, 30, tzinfo=timezone.utc)
    names = {new_run(now) for _ in range(1000)}
    assert len(names) == 1000 and all(name.startswith('20261122T063000Z-') for name in names)


def fields(schema, prefix=''):
    """Return the dotted names of a schema's fields."""
    for name, field in schema['properties'].items():
        yield prefix + name
        for inner in (field, field.get('items', {}), *field.get('oneOf', ())):
            if 'properties' in inner:
                yield from fields(inner, f'{prefix}{name}.')


def test_every_field_is_explained():
    text = (Path(__file__).resolve().parents[2] / 'docs' / 'live.md').read_text()
    for path in (PASS_SCHEMA, TRACK_STATES_SCHEMA):
        for name in fields(json.loads(path.read_text())):
            assert f'| `{name}` |' in text, name


def test_track_states_show_which_updates_are_measurements():
    pair = StereoPair(3, 10, 12, np.zeros((2, 2), np.uint8), np.zeros((2, 2), np.uint8))
    updates = [TrackUpdate(10, track, 'near', state, 24.5, 0.1, 12.0, -0.5, np.zeros(3),
                           np.eye(3), np.eye(3), np.zeros((4, 2)), np.zeros((4, 2)))
               for track, state in enumerate(TrackState)]
    found = valid(track_states_text(RUN, pair, updates), TRACK_STATES_SCHEMA)
    assert (found['stamp_ns'], found['right_stamp_ns']) == (10, 12)
    assert [(t['frame_id'], t['state'], t['measured'], t['speed_mps'])
            for t in found['tracks']] == [
        ('vehicle_0', 'tentative', False, None), ('vehicle_1', 'confirmed', True, 24.5),
        ('vehicle_2', 'coasting', False, None)]
    assert found['tracks'][1]['id'] == RUN + '-000001'
    assert valid(track_states_text(RUN, pair, []), TRACK_STATES_SCHEMA)['tracks'] == []
