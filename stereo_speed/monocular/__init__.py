# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""One camera, the environment as state (Zhu, Lao and Zheng 2010)."""
