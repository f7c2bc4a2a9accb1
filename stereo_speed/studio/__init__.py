# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A page where a person sets up a site, watches it live and reviews passes."""
