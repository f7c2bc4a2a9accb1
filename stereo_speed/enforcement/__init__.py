# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""From passes to violations: the decision, the evidence, its chain and its verification."""
