# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The pass that the live tests measure."""
from __future__ import annotations

from pathlib import Path

import pytest

SAMPLE = Path(__file__).resolve().parents[2] / 'sample' / 'straight55'


@pytest.fixture()
def sample():
    """Give the sample pass that comes with the package."""
    return SAMPLE
