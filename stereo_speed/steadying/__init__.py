# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""How the cameras sway: their rotation in each pair, by what stands still."""
