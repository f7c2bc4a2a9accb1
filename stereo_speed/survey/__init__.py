# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What many measured passes say: of the traffic, and of the instrument beside a reference."""
