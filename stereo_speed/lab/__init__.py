# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The laboratory: simulators, baselines, evaluation. The instrument does not import it."""
