# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Evaluation of trackers and detectors against the truth."""
