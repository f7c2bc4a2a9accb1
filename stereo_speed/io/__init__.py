# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Bags, images, videos, calibrations and result files."""
