# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Many jobs: over the cores of a machine, or over a cluster."""
