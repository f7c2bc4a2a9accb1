# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Tracking in one camera with the environment as part of the state (Zhu et al. 2010)."""
