# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How a node that measures is started: its processes first, and only then what has to do with ROS.

``rclpy`` has threads of its own as soon as it is imported, and a process that has others cannot be
forked.
"""
from __future__ import annotations

import gc
from importlib import import_module
import sys
from typing import Optional, Sequence

from .helpers import Helpers


def start(module: str, kind: str, args: Optional[Sequence[str]] = None) -> int:
    """
    Run a node until it is told to stop; return its exit status, as of ``common.run``.

    :param module: that has its class.
    :param kind: name of the class, which takes the helpers that were made for it.
    :param args: command line.
    """
    given, helpers = list(sys.argv[1:] if args is None else args), Helpers()
    gc.disable()  # to look for garbage in what is imported takes a tenth of the time
    if not {'-h', '--help'} & set(given):
        helpers.fork()
    run_measuring = import_module('.lifecycle', __package__).run_measuring
    made = getattr(import_module(module), kind)
    gc.freeze()  # what is there by now stays
    gc.enable()
    try:
        status: int = run_measuring(made, helpers, given)
        return status
    finally:
        helpers.close()
