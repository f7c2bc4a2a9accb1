# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Starts ``tracker_node``, which ``tracker.py`` defines."""
from __future__ import annotations

from functools import partial

from .start import start

main = partial(start, 'stereo_speed.nodes.tracker', 'TrackerNode')

if __name__ == '__main__':
    raise SystemExit(main())
