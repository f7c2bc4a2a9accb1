# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""From rough clicks and a bag's own images to a site that is known to a few hundredths of a px."""
