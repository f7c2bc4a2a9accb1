# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Lengths of fronts that the detectors and the trackers agree on; the first three are defaults."""
from __future__ import annotations

NARROW_M = 1.2  # greatest width of a two-wheeler
TALL_WIDTH_M = 2.14  # least width of a lorry or bus
TALL_HIGH_M = 1.25  # height above the road of the lower edge of its windscreen
LEAST_FRONT_M = 0.3  # least height of a part of a front that is measured
