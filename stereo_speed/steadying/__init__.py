# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The rotation of the cameras in each pair, estimated from the static background."""
