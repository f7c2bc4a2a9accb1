# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Evaluation of many passes: traffic statistics, and errors against a reference."""
