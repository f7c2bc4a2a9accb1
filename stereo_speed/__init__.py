# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Ground speed of vehicles, with its uncertainty, from a roadside stereo camera."""

__version__ = '1.0.0'
