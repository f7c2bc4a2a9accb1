# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
One thread for linear algebra.

The matrices here are small: more threads only wait for one another, and on a busy machine for
long.  The libraries read their environment when they are loaded, so this comes first in every
command and node; what the user has set stays.
"""
from __future__ import annotations

import os

VARIABLES = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')


def one_blas_thread() -> None:
    """Set the environment of this process and its children, before numpy is imported."""
    for name in VARIABLES:
        os.environ.setdefault(name, '1')
