# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What every room speaks: records, errors, units, parameters."""
