# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Other published methods to measure the same passes, behind the same protocol."""
