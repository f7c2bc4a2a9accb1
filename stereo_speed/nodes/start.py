# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Starts a measuring node: first its helper processes, and only then ROS.

``rclpy`` starts threads when it is imported, and a process with several threads cannot be forked.
"""
from __future__ import annotations

import gc
from importlib import import_module
import sys
from typing import Optional, Sequence, TYPE_CHECKING

if TYPE_CHECKING:
    from .helpers import Helpers


def start(module: str, class_name: str, args: Optional[Sequence[str]] = None) -> int:
    """
    Run a node until it is told to stop; return its exit status as ``common.run`` does.

    :param module: module of the node's class.
    :param class_name: name of the class, whose constructor takes ``helpers``.
    :param args: command line; None for that of this process.
    """
    words = list(sys.argv[1:] if args is None else args)
    gc.disable()  # garbage collection would take a fifth of the time of the imports, all below
    helpers: Helpers = import_module('.helpers', __package__).Helpers()
    try:
        if not {'-h', '--help'} & set(words):
            helpers.fork()
        run_measuring = import_module('.lifecycle', __package__).run_measuring
        node_class = getattr(import_module(module), class_name)
        gc.freeze()  # present objects stay, so later collections need not scan them
        gc.enable()
        status: int = run_measuring(node_class, helpers, words)
        return status
    finally:
        helpers.close()
