# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated passes, rendered once for all tests of the trackers."""
from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_speed.lab.sim.config import straight_config
from stereo_speed.lab.sim.sequence import simulate

cv2.setNumThreads(1)


@pytest.fixture(scope='session')
def straight():
    """55 mph on a straight road, with two pairs lost on the way."""
    return simulate(straight_config('55 mph', drop=(4, 5)), np.random.default_rng(1))
