# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Closed forms from the papers, as references for tests."""
