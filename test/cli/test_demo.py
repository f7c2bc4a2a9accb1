# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The line that the demo prints for a reading."""
from __future__ import annotations

from stereo_speed.cli.demo import reading_line
from stereo_speed.core.units import MPH_MPS
from stereo_speed.io.truth import truth_of_rows

START_NS = 1_700_000_000_123_456_000
TRUTH, = truth_of_rows([{'stamp_ns': START_NS + k * 33_333_333, 'vehicle': 0,
                         'speed': (55 + k) * MPH_MPS} for k in range(3)])


def test_truth_beside_a_reading_is_that_of_its_stamp():
    """Also where stamps are not whole milliseconds."""
    reading = (START_NS + 66_666_666, 'vehicle_0', 56.75 * MPH_MPS, 0.1 * MPH_MPS)
    assert reading_line(reading, TRUTH) == (
        '  0.1 s  vehicle_0   56.75 ± 0.10 mph   truth  57.00   error -0.25')


def test_reading_without_a_truth_is_printed_alone():
    reading = (START_NS + 50_000_000, 'vehicle_0', 56.75 * MPH_MPS, 0.1 * MPH_MPS)
    assert reading_line(reading, TRUTH).endswith('0.10 mph')
