# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The declarations of the parameters that all trackers share."""
from __future__ import annotations

from dataclasses import fields

from stereo_speed.core.config import parameters_of
from stereo_speed.core.tracker_config import TrackerConfig


def test_every_parameter_has_a_meaning():
    for name, field in parameters_of(TrackerConfig):
        meta = field.metadata
        assert meta['doc'] and not meta['doc'].endswith('.'), name
        if meta['choices']:
            assert field.default in meta['choices'], name
        elif isinstance(field.default, (int, float)) and not isinstance(field.default, bool):
            assert meta['low'] <= field.default <= meta['high'], name
    assert len({f.name for f in fields(TrackerConfig)}) == len(fields(TrackerConfig))
