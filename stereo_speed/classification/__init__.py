# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Size and class of each vehicle, measured in both views of some pairs."""
