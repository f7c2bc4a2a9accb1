# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels as they are compiled, and as plain numpy."""
from __future__ import annotations

import pytest


@pytest.fixture(params=['plain', 'compiled'])
def of_kernel(request):
    """Return what picks one of the two functions of a kernel."""
    if request.param == 'plain':
        return lambda kernel: kernel.plain
    pytest.importorskip('numba')
    return lambda kernel: kernel.compiled()
