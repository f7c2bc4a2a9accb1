# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A second estimate of each pass, from other evidence and by other code than the first one."""
