# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How a node that measures is started: its processes first, and only then what has to do with ROS.

``rclpy`` has threads of its own as soon as it is imported, and a process that has others cannot be
forked.
"""
from __future__ import annotations

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
    if not {'-h', '--help'} & set(given):
        helpers.fork()
    try:
        status: int = import_module('.lifecycle', __package__).run_measuring(
            getattr(import_module(module), kind), helpers, given)
        return status
    finally:
        helpers.close()
