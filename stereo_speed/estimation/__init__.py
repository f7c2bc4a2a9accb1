# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Gaussian inference and particle filters."""
