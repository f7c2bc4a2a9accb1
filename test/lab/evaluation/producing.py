# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Work for the processes of the producer's tests."""
from __future__ import annotations

import os
import signal


def squares(count, fail_at=None, die_at=None):
    """Yield squares, and fail or die at one of them."""
    for n in range(count):
        if n == fail_at:
            raise ValueError(f'no square of {n}')
        if n == die_at:
            os.kill(os.getpid(), signal.SIGKILL)
        yield n ** 2
