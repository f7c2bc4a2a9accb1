# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Records survive the round trip through JSON to the last bit."""
from __future__ import annotations

import dataclasses

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.passes import PassResult, Reason, SpeedBudget, TrackEnd, Verdict
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.io.record_json import record_of, record_text

FLOAT = st.floats(allow_nan=False, allow_infinity=False)


def same(a, b):
    """Compare records, with arrays to the last bit."""
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(
            same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return type(a) is type(b) and a == b


@settings(max_examples=60, deadline=None)
@given(FLOAT, FLOAT, st.integers(0, 2 ** 62), st.text(max_size=5))
def test_records_round_trip(x, y, ns, name):
    update = TrackUpdate(
        stamp_ns=ns, track=3, lane=name, state=TrackState.COASTING, speed_mps=x, speed_std_mps=y,
        s_m=1 / 3, lateral_m=-x, position_m=np.array([x, y, 0.1]),
        position_cov_m2=np.eye(3) * y, axes=np.eye(3),
        quad_left_px=np.full((4, 2), x, np.float32), quad_right_px=np.zeros((4, 2)))
    result = PassResult(
        track=3, lane=name, first_ns=ns, last_ns=ns, pairs=2, speed_mps=None, speed_std_mps=None,
        verdict=Verdict.REJECTED, reason=Reason.TOO_FAR, smoothed={ns: x}, smoothed_std={ns: y},
        budget=SpeedBudget(x, y, 0.0, 1.0), end=TrackEnd.LOST)
    text = record_text([update, result, 4])
    assert '\n' not in text
    first, second, third = record_of(text, 'file')
    assert same(update, first) and same(result, second) and third == 4


@pytest.mark.parametrize('text', [
    '{', '{"!": "Path", "v": "/etc/passwd"}', '{"!": "np", "v": {}}', '{"!": "TrackUpdate"}',
    '{"!": "TrackUpdate", "v": {"stamp": 1}}', '{"!": "Verdict", "v": "guilty"}',
    '{"!": "array", "dtype": "?!", "v": 1}', '{"!": "array", "dtype": "<f8", "v": "x"}',
])
def test_invalid_line_is_refused_in_one_line(text):
    with pytest.raises(InputError, match='records of a run') as error:
        record_of(text, 'file')
    assert '\n' not in str(error.value)
