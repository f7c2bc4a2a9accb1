# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A web page to set up a site, watch it live and review passes."""
