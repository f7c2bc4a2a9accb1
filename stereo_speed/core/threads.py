# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Limits linear algebra to one thread.

The matrices here are small: several threads would only wait for one another, and for long on a
busy machine.  The libraries read the environment when they are loaded, so every command and node
calls this first; values that the user has set are kept.
"""
from __future__ import annotations

import os

VARIABLES = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')


def one_blas_thread() -> None:
    """Set the environment of this process and its children; call it before importing numpy."""
    for name in VARIABLES:
        os.environ.setdefault(name, '1')
