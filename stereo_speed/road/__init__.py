# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Roads: paths, the road model, its fit to picked lines, and lanes."""
