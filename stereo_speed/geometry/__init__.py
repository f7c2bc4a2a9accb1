# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Cameras, lenses, rigs, rays and planes."""
