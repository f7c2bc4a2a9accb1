# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""From a site and a stream of pairs to results."""
